"""Property tests find the same cases every time, and a slow machine is not a failure."""

from hypothesis import settings

settings.register_profile("station", deadline=None, derandomize=True)
settings.load_profile("station")
