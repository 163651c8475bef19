"""Array types, the one way data types hold arrays (float64, contiguous, read-only, shape checked); runs, medians."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
ComplexArray = npt.NDArray[np.complex128]
MAD_TO_SIGMA = 1.4826  # sigma of normal numbers over the median of their distances from their middle
_TOGETHER = 1 << 19


def frozen(value: npt.ArrayLike, shape: Sequence[int | None], name: str) -> Array:
    """Return `value` as a read-only float64 array of the given shape (None: any length).

    Raises ValueError, naming `name`, when the shape does not fit. A read-only array is passed on without a copy.
    """
    array = np.ascontiguousarray(value, dtype=np.float64)
    _check_shape(array, shape, name)
    if array.flags.writeable:
        array = array.copy() if array is value or array.base is not None else array
        array.flags.writeable = False
    return array


def frozen_int(value: npt.ArrayLike, shape: Sequence[int | None], name: str) -> IntArray:
    """Return `value` as a read-only int64 array of the given shape; see :func:`frozen`."""
    array = np.array(value, dtype=np.int64)
    _check_shape(array, shape, name)
    array.flags.writeable = False
    return array


def numbers(value: Any, shape: Sequence[int], largest: float = np.inf) -> Array:
    """Return a value of a settings file as a read-only array. Raises ValueError unless it is finite numbers of a shape.

    A text, a truth value, or what is not below `largest`, is no such number.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != tuple(shape) or not np.all(np.abs(array) < largest) or _holds_text(value):
        wanted = f"{' x '.join(map(str, shape))} finite numbers" if shape else "a finite number"
        raise ValueError(f"must be {wanted}")
    array.flags.writeable = False
    return array


def _holds_text(value: Any) -> bool:
    return any(map(_holds_text, value)) if isinstance(value, list) else isinstance(value, str | bool)


def freeze(instance: object, **shapes: Sequence[int | None]) -> None:
    """Make the named arrays of a frozen dataclass read-only, each of its shape; see :func:`frozen`."""
    for name, shape in shapes.items():
        value = frozen(getattr(instance, name), shape, f"{type(instance).__name__}.{name}")
        object.__setattr__(instance, name, value)


def require_increasing(t: Array, name: str) -> None:
    """Raise ValueError unless `t` (N,) is finite and strictly increasing."""
    if not all(np.all(np.isfinite(t[i : i + _TOGETHER])) for i in range(0, t.size, _TOGETHER)):
        raise ValueError(f"{name} holds a time that is not finite")
    if not is_increasing(t):
        raise ValueError(f"{name} is not strictly increasing in time")


def is_increasing(t: Array) -> bool:
    """Return whether `t` (N,) is strictly increasing; looked at bit by bit, to spare a long recording the memory."""
    return all(np.all(np.diff(t[i : i + _TOGETHER + 1]) > 0.0) for i in range(0, t.size, _TOGETHER))


def are_near(t: Array, others: Array, reach: float) -> BoolArray:
    """Mask (N,) of the times t (N,) s that lie within `reach` s of any of `others` (M,) s, in order."""
    first, last = (np.searchsorted(others, t + side * reach) for side in (-1.0, 1.0))
    return np.asarray(last > first)


def runs_of(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """First index of each run of true in `mask` (N,), and the index behind its last, both (R,)."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return changes[0::2], changes[1::2]


def median(values: Array) -> float:
    """Return what `np.median` gives of values (N,), N > 0; of some thousands in a fifth of the time.

    Numpy selects both middle ones of an even number at once; selecting one at a time is faster.
    """
    middle = values.size // 2
    parted = np.partition(values, middle)  # what is not a number stands last
    if np.isnan(parted[middle:].max()):
        return np.nan
    upper = float(parted[middle])
    return upper if values.size % 2 else 0.5 * (float(parted[:middle].max()) + upper)


def _check_shape(array: npt.NDArray[Any], shape: Sequence[int | None], name: str) -> None:
    fits = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name} has shape {array.shape}, wanted {tuple(shape)}")
