"""Where the routines of LAPACK come from: SciPy's wrappers of them, without the rest of `scipy.linalg`.

That package imports all of NumPy, its Fortran tools and its testing included, and takes as long to come as NumPy and
GTSAM together; the wrappers are one extension module in it. Refuses nothing: where that module is not found alone, the
whole package comes.
"""

from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType

import scipy

EXTENSION = "_flapack"


def lapack_routines() -> ModuleType:
    """Return the module that wraps LAPACK's routines, with the names and arguments of `scipy.linalg.lapack`."""
    spec = PathFinder.find_spec(EXTENSION, [str(Path(scipy.__file__).parent / "linalg")])
    if spec is None or spec.loader is None:
        return import_module("scipy.linalg.lapack")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
