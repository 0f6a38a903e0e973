"""Threads of the linear algebra that numpy and scipy bring along."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits


P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function with one thread for BLAS while it runs.

    Matrices of some hundred rows gain nothing by more, and the threads wait for one another in
    loops: where other processes have work, too, an audit takes ten to twenty times as long.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
