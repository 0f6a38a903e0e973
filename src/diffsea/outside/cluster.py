"""Work on a cluster: tasks go to the workers of a Dask scheduler, results come as they finish.

Whoever asks keeps what comes; workers write nothing and need no files of the asker's. A task that
fails is tried again, here or there, and told in the end: the others go on.
"""

import asyncio
import concurrent.futures
import contextlib
import dataclasses
import functools
import importlib.metadata
import itertools
import logging
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

from diffsea.errors import UserError
from diffsea.progress import Progress, Remark, no_progress
from diffsea.runtime import prepare_jax


if TYPE_CHECKING:
    from distributed import Client, Future

Task = TypeVar("Task")

RETRIES = 3  # of a task that raised an error
PATIENCE = 10.0  # s, within which a scheduler has to answer
POLL = 1.0  # s, between looks at how many workers there are
SAME = ("diffsea", "jaxlib")  # packages on whose version results depend


@dataclasses.dataclass(frozen=True)
class Failed:
    """What became of a task that failed as often as it was tried."""

    reason: str
    has_killed: bool = False  # workers died that had it


class OtherVersionError(Exception):
    """A worker has other versions than the one who asks."""


class Workers:
    """The workers of a cluster, made by `connected`."""

    def __init__(self, client: "Client", progress: Progress):
        self._client, self._progress = client, progress
        self._under_way: dict[Future, Any] = {}  # the task of each
        self._is_waiting = False  # there is no worker

    def results(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> "Iterator[tuple[Task, Any]]":
        """Each task with what the function makes of it, or a `Failed`, as they finish.

        A task that raises is tried `RETRIES` times again. One whose worker dies is moved as often
        as the scheduler allows (`distributed.scheduler.allowed-failures`, by default 3), and then
        again as often when all others are done.

        Arguments:
            function: what it holds is sent along, to be kept by each worker.
            tasks: plain data; no more of them are taken than there are threads of workers.

        Raises:
            UserError: the scheduler is gone, or a worker has another version.
        """
        import cloudpickle

        call, suspects = cloudpickle.dumps(function), []
        for task, found in self._finished(call, tasks, self._threads):
            if isinstance(found, Failed) and found.has_killed:
                suspects.append(task)
            else:
                yield task, found
        # A death is laid to everything that a worker had: alone, a task answers for itself.
        yield from self._finished(call, suspects, lambda: 1)

    def _finished(
        self, call: bytes, tasks: Iterable[Task], width: Callable[[], int]
    ) -> "Iterator[tuple[Task, Any]]":
        """Tasks with their results, so many under way at once."""
        from distributed import wait

        waiting, versions = iter(tasks), _versions()
        with _scheduler_needed():
            while True:
                room = max(width() - len(self._under_way), 0)
                for task in itertools.islice(waiting, room):
                    options = {"retries": RETRIES, "pure": False}
                    future = self._client.submit(_do, call, task, versions, **options)
                    self._under_way[future] = task
                if not self._under_way:
                    return
                with contextlib.suppress(TimeoutError):
                    wait(list(self._under_way), POLL, "FIRST_COMPLETED")
                for future in [one for one in self._under_way if one.done()]:
                    yield self._under_way[future], _result_of(future)
                    del self._under_way[future]  # only now, so that `cancel` frees its result

    def _threads(self) -> int:
        """How many tasks the workers do at once; one where there is no worker yet."""
        threads: Any = self._client.nthreads()
        count = sum(threads.values())
        if not count and not self._is_waiting:
            self._progress(Remark("waiting: the cluster has no worker"))
        self._is_waiting = not count
        return max(count, 1)

    def cancel(self) -> None:
        """Give up what is under way."""
        self._client.cancel(list(self._under_way))


@contextlib.contextmanager
def connected(cluster: "Client | str", progress: Progress = no_progress) -> Iterator[Workers]:
    """The workers of a cluster; what is under way at the end is given up.

    Arguments:
        cluster: a client, or the address of a scheduler, such as `tcp://10.0.0.5:8786`.

    Raises:
        UserError: the package `distributed` is not installed, no scheduler answers, or a worker
            has another version.
    """
    try:
        from distributed import Client
    except ImportError:
        raise UserError(
            "a cluster needs the package distributed: pip install 'diffsea[cluster]'"
        ) from None
    with contextlib.ExitStack() as stack:
        if isinstance(cluster, Client):
            client = cluster
        else:
            _check_scheduler(cluster)
            stack.enter_context(_silent("distributed.client"))
            client = stack.enter_context(Client(cluster, timeout=PATIENCE, set_as_default=False))
        stack.enter_context(client.as_current())
        _check_versions(client)
        workers = Workers(client, progress)
        stack.callback(workers.cancel)
        yield workers


@contextlib.contextmanager
def _silent(name: str) -> Iterator[None]:
    """A logger without a word: what it has to say is told in our own."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


def _check_scheduler(address: str) -> None:
    """Raise `UserError` where no scheduler answers.

    Asked before there is a client: one that finds none takes long to end, and says so.
    """
    try:
        # In a thread: a notebook has a loop of its own in this one.
        with concurrent.futures.ThreadPoolExecutor(1) as thread:
            kind = thread.submit(asyncio.run, _kind_at(address)).result()
    except Exception as error:  # of any kind: what listens there may talk anything
        kind = " ".join(str(error).split()) or type(error).__name__
    if kind != "Scheduler":
        raise UserError(
            f"no Dask scheduler answers at {address} ({kind}): start one (`dask scheduler`) and "
            "give the address that it tells, such as tcp://10.0.0.5:8786"
        )


async def _kind_at(address: str) -> str:
    """What listens at an address: `Scheduler`, `Worker` ..."""
    from distributed import rpc
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    async with rpc(address, timeout=PATIENCE, connection_args=arguments) as peer:
        told: Any = await asyncio.wait_for(peer.identity(), PATIENCE)
        return told["type"]


def _versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name) for name in SAME}


def _check_versions(client: "Client") -> None:
    """Raise `UserError` where a worker has another version, or lacks the package."""
    for name, own in _versions().items():
        # A function of the standard library: the worker may have no such module as this one.
        found: Any = client.run(importlib.metadata.version, name, on_error="return")
        for worker, version in found.items():
            if isinstance(version, importlib.metadata.PackageNotFoundError):
                version = "no"
            if isinstance(version, str) and version != own:
                raise UserError(_told(worker, name, version, own))


def _told(worker: str, name: str, version: str, own: str) -> str:
    return f"the worker {worker} has {name} {version}, here it is {own}: install the same on all"


@contextlib.contextmanager
def _scheduler_needed() -> Iterator[None]:
    """Turns the loss of the scheduler into a `UserError`."""
    from distributed import CancelledError

    try:
        yield
    except (CancelledError, OSError) as error:
        raise UserError("the scheduler is gone: start one and run the same again") from error


def _result_of(future: "Future") -> Any:
    """What a task that is finished came to, a `Failed` where it failed.

    Raises:
        UserError: its worker has another version.
    """
    from distributed import CancelledError, KilledWorker

    try:
        return future.result()
    except CancelledError:
        raise
    except KilledWorker as error:
        tries = error.allowed_failures + 1
        told = f"{tries} workers died while they had it, the last {error.last_worker.address}"
        return Failed(f"{told}: a bug, or a lack of memory", has_killed=True)
    except OtherVersionError as error:
        raise UserError(str(error)) from None
    except UserError as error:
        return Failed(str(error))
    except Exception as error:
        return Failed(f"{type(error).__name__}: {error}")


def _do(call: bytes, task: Any, versions: dict[str, str]) -> Any:
    """One task, by a worker."""
    for name, own in _versions().items():
        if own != versions[name]:
            from distributed import get_worker

            raise OtherVersionError(_told(get_worker().address, name, own, versions[name]))
    prepare_jax()
    return _loaded(call)(task)


@functools.lru_cache(maxsize=4)
def _loaded(call: bytes) -> Callable[[Any], Any]:
    """The function of tasks, once for all of a worker's, so that it keeps what it has compiled.

    It travels as bytes: what it needs imports JAX, which has to be set up before.
    """
    import cloudpickle

    return cloudpickle.loads(call)
