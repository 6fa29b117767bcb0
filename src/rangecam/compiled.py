"""How a kernel is compiled: when it is first called, and kept on disk until anything that it is made of changes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, overload

from numba import njit

from rangecam import types

F = TypeVar("F", bound=Callable[..., Any])


@overload
def kernel(function: F) -> F: ...
@overload
def kernel(**options: Any) -> Callable[[F], F]: ...


def kernel(function: Any = None, **options: Any) -> Any:
    """Compile loops over arrays as `njit(cache=True, nogil=True)` does, also where they use kernels of other files.

    Alone or with further options of `njit`: `@kernel`, `@kernel(error_model="numpy")`.

    Numba's cache on disk notices changes of the file that a kernel is in, not of those whose kernels it takes in. So
    what marks its cache as fresh is, beside its own file, that of each kernel that its module imports, which has been
    given those of what it imports in turn; and that of `types.py`, whose columns are constants in kernels. With
    NUMBA_DISABLE_JIT=1 nothing is compiled, and the function stays what it is.
    """
    if function is None:
        return lambda each: kernel(each, **options)
    made: Any = njit(cache=True, nogil=True, **options)(function)
    if not hasattr(made, "py_func"):
        return function
    others = [each for each in function.__globals__.values() if hasattr(each, "py_func")]
    marks = {repr(_index(each)._source_stamp) for each in others if each.__module__ != function.__module__}
    columns = Path(types.__file__).stat()
    _index(made)._source_stamp = (_index(made)._source_stamp, columns.st_mtime, columns.st_size, *sorted(marks))
    return made


def _index(dispatcher: Any) -> Any:
    """Return the index of a dispatcher's cache on disk, to which Numba has no public way."""
    return dispatcher._cache._cache_file
