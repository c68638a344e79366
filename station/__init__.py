"""Flight test station: corrected angle of attack and live aerodynamic derivatives at 50 Hz.

As a library: `station.open`, `identify`, `diagnose`, `simulate`, `campaign` and `import_file` are those of station.api,
imported when they are first named.
"""

from __future__ import annotations

import importlib as _importlib
import importlib.util as _util
import os as _os
import sys as _sys
import tempfile as _tempfile
from pathlib import Path as _Path
from types import ModuleType as _ModuleType
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from station.sources import sources as _sources

if _TYPE_CHECKING:
    from station.api.diagnosing import Diagnosed, diagnose
    from station.api.flown_recording import Recording, import_file, open, simulate
    from station.api.identifying import Identified, identify
    from station.api.monte_carlo import Campaigned, campaign
    from station.profile import Aircraft, load_aircraft
    from station.rows import LogError, ProfileError, StationError, UsageError

__all__ = [
    "Aircraft",
    "Campaigned",
    "Diagnosed",
    "Identified",
    "LogError",
    "ProfileError",
    "Recording",
    "StationError",
    "UsageError",
    "campaign",
    "diagnose",
    "identify",
    "import_file",
    "load_aircraft",
    "open",
    "simulate",
]
_PLACES = {
    **dict.fromkeys(("Recording", "import_file", "open", "simulate"), "station.api.flown_recording"),
    **dict.fromkeys(("Identified", "identify"), "station.api.identifying"),
    **dict.fromkeys(("Diagnosed", "diagnose"), "station.api.diagnosing"),
    **dict.fromkeys(("Campaigned", "campaign"), "station.api.monte_carlo"),
    **dict.fromkeys(("Aircraft", "load_aircraft"), "station.profile"),
    **dict.fromkeys(("LogError", "ProfileError", "StationError", "UsageError"), "station.rows"),
}


def _compiled_code_of_these_sources() -> str:
    """Folder for compiled kernels, one for each state of the sources.

    numba compiles a kernel anew when its own file changes, but not when a kernel that it calls does: after an update
    stale code would give wrong numbers. Must be set before numba is first imported.
    """
    name = _sources()
    for folder in (_os.environ.get("XDG_CACHE_HOME", ""), _os.path.expanduser("~/.cache")):
        if _os.path.isabs(folder) and _is_writable(cache := _Path(folder) / "flight-test-station" / name):
            return str(cache)
    # A read-only system, or a user without a home: a folder of this user's in the place for temporary files.
    cache = _Path(_tempfile.gettempdir()) / f"flight-test-station-{_os.getuid()}"
    if _is_writable(cache, 0o700) and cache.stat().st_uid == _os.getuid():
        return str(cache / name)
    return _tempfile.mkdtemp(prefix="flight-test-station-")


def _is_writable(folder: _Path, mode: int = 0o777) -> bool:
    try:
        folder.mkdir(mode, parents=True, exist_ok=True)
    except OSError:
        return False
    return _os.access(folder, _os.W_OK | _os.X_OK)


def _keep_bytecode(folder: str) -> None:
    """Where Python may not write bytecode beside its sources and has none, keep it in the folder of compiled code:
    without, the station's imports take five times as long, each time."""
    numpy = _util.find_spec("numpy")
    may_not = _sys.dont_write_bytecode or not _os.access(_Path(__file__).parent, _os.W_OK)
    if numpy is None or numpy.origin is None or not may_not:
        return
    if not _Path(_util.cache_from_source(numpy.origin)).exists():
        _sys.pycache_prefix = _os.environ["PYTHONPYCACHEPREFIX"] = folder
        _sys.dont_write_bytecode = False
        _os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


if "NUMBA_CACHE_DIR" not in _os.environ:
    _os.environ["NUMBA_CACHE_DIR"] = _compiled_code_of_these_sources()
    _keep_bytecode(_os.path.join(_os.path.dirname(_os.environ["NUMBA_CACHE_DIR"]), "bytecode"))
# The matrices are small: threads of the linear algebra only spin beside the loop and the workers, and their number
# would be part of the last bit. Must be set before numpy is first imported.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    _os.environ.setdefault(_threads, "1")


def __getattr__(name: str) -> _Any:
    if name not in __all__:
        raise AttributeError(f"module 'station' has no attribute {name!r}")
    return getattr(_importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Station(_ModuleType):
    """This package, whose function `campaign` has the name of the wing that it flies with: importing that wing would
    otherwise put it in the function's place."""

    @property
    def campaign(self) -> _Any:
        return __getattr__("campaign")

    @campaign.setter
    def campaign(self, _: _ModuleType) -> None: ...


_sys.modules[__name__].__class__ = _Station
