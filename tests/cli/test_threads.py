"""One thread for BLAS, and as many as before afterwards."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from diffsea.runtime import one_blas_thread


def threads_of_blas():
    np.linalg.inv(np.eye(2))
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_a_function_runs_with_one_blas_thread_and_leaves_as_many_as_before():
    with threadpool_limits(2, user_api="blas"):
        assert threads_of_blas() == {2}
        assert one_blas_thread(threads_of_blas)() == {1}
        assert threads_of_blas() == {2}
        with pytest.raises(ZeroDivisionError):
            one_blas_thread(lambda: 1 / 0)()
        assert threads_of_blas() == {2}
