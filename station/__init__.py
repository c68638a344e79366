"""Flight test station: corrected angle of attack and live aerodynamic derivatives at 50 Hz."""

import hashlib as _hashlib
import os as _os
from pathlib import Path as _Path


def _compiled_code_of_these_sources() -> str:
    """Folder for compiled kernels, one for each state of the sources.

    numba compiles a kernel anew when its own file changes, but not when a kernel that it calls does: after an update
    stale code would give wrong numbers. Must be set before numba is first imported.
    """
    digest = _hashlib.sha256()
    for source in sorted(_Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    cache = _Path(_os.environ.get("XDG_CACHE_HOME") or _Path.home() / ".cache")
    return str(cache / "flight-test-station" / digest.hexdigest()[:16])


_os.environ.setdefault("NUMBA_CACHE_DIR", _compiled_code_of_these_sources())
# The matrices are small: threads of the linear algebra only spin beside the loop and the workers, and their number would
# be part of the last bit. Must be set before numpy is first imported.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    _os.environ.setdefault(_threads, "1")
