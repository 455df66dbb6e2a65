"""Computation of tiles on dask's workers, on any host.

dask keeps results in the memory of its workers and loses them with its scheduler. Results are therefore fetched and
released at once, only a few tiles per worker are submitted at a time, and the unfinished tiles of a lost scheduler are
submitted again to the next one at the same address.

A repeated short wait and a check of the client's state distinguish a dead scheduler from slow work.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib import import_module
from ipaddress import ip_address
from typing import Any, Self
from urllib.parse import urlsplit

from rig_basics.ignoring import ignoring
from studies.errors import EngineLost, EngineMissing, StudyInputError, TileFailed
from studies.study import Study
from studies.worker import answer_tile

_TILES_PER_THREAD = 2  # submitted tiles per thread of the workers
_MIN_SUBMITTED = 4
_PATIENCE_S = 60.0  # timeout for a lost scheduler, and for workers
_MAX_DEATHS = 10  # of workers with the same tile, before the tile fails
_CHECK_S = 2.0  # interval between counts of the workers
_WAIT_S = 0.2  # timeout for a tile, before the scheduler is checked
_CERTIFICATES = (
    "set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, …__CLIENT__CERT and …__CLIENT__KEY to PEM files, or the same in dask's "
    "configuration (docs/how-to/analyst/compute_on_several_machines.md)"
)
_CONNECTION_FAULTS = (OSError, CancelledError)  # timeouts and closed connections are OSErrors too
_log = logging.getLogger(__name__)


class DaskWorkers:
    """The workers of a dask scheduler.

    Args:
        address: tcp://HOST:PORT, or tls://HOST:PORT with dask's own settings of certificates.
        notify: called with a sentence when the engine waits or has lost something.
        patience_s: timeout for a scheduler and for workers, s.
    Raises:
        EngineMissing: dask is not installed.
        StudyInputError: tls:// without certificates.
    """

    def __init__(self, address: str, notify: Callable[[str], None], patience_s: float = _PATIENCE_S) -> None:
        try:
            self._dask: Any = import_module("distributed")  # of an extra, without types; a second to import
        except ImportError as missing:
            raise EngineMissing(
                f"the scheduler {address} needs dask, which is not installed here ({missing}); "
                "pip install 'pendulum-balancer-rig[studies]', or choose local:N, processes of this machine"
            ) from missing
        self.name: str = address
        self._address, self._notify, self._patience_s = address, notify, patience_s
        self._client: Any = None
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # losses are reported here, in plain words
        if address.startswith("tls://"):
            _need_certificates(address)
        if address.startswith("tcp://") and not _loopback(address):
            notify(
                f"{address} is not of this machine and not encrypted: anyone who reaches that port can run programs "
                "on the workers; use tls:// or an ssh tunnel"
            )

    def __enter__(self) -> Self:
        self._connect()
        return self

    def __exit__(self, *ending: Any) -> None:
        """Disconnect from the scheduler; unfinished tiles are dropped there."""
        self._disconnect()

    def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
        """Compute tiles; see Engine."""
        left, deaths = list(reversed(tiles)), Counter[int]()
        while left:
            done = set[int]()
            try:
                for tile, content in self._by_one_scheduler(study, left, deaths):
                    done.add(tile)
                    yield tile, content
            except _SchedulerLost as lost:
                _log.info("connection to %s: %r", self._address, lost.__cause__)
                self._notify(f"the scheduler at {self._address} is gone; what is done is kept")
                self._disconnect()
                self._connect()
            left = [tile for tile in left if tile not in done]

    def _by_one_scheduler(self, study: Study, tiles: list[int], deaths: Counter[int]) -> Iterator[tuple[int, bytes]]:
        """Yield finished tiles while the scheduler is connected."""
        client, left, running = self._client, list(tiles), dict[Any, int]()
        window, looked, seen = 0, -_CHECK_S, time.monotonic()
        while left or running:
            if time.monotonic() - looked > _CHECK_S:
                looked, threads = time.monotonic(), self._threads()
                window = max(_MIN_SUBMITTED, _TILES_PER_THREAD * threads)
                seen = time.monotonic() if threads else seen
                if time.monotonic() - seen > self._patience_s:
                    raise EngineLost(
                        f"no worker at {self._address} for {self._patience_s:.0f} s; start some with "
                        f"`dask worker {self._address}` and give the same command again: what is done is kept"
                    )
            while left and len(running) < window:
                tile = left.pop()
                running[self._submit(study, tile, deaths[tile])] = tile
            for future in self._ended(client, running):
                tile = running.pop(future)
                content = self._result(future, tile, deaths)
                if content is None:
                    left.append(tile)
                else:
                    yield tile, content

    def _submit(self, study: Study, tile: int, deaths: int) -> Any:
        arguments = study.kind, study.text, study.software, tile
        key = f"{study.digest}-{tile:06d}" + (f"-{deaths}" if deaths else "")
        with _scheduler_needed():
            return self._client.submit(answer_tile, *arguments, key=key, pure=False)

    def _ended(self, client: Any, running: dict[Any, int]) -> list[Any]:
        """Return the futures that have ended, after a short wait at most."""
        try:
            with client.as_current():
                self._dask.wait(list(running), timeout=_WAIT_S, return_when="FIRST_COMPLETED")
        except TimeoutError:  # usual: no tile has ended yet
            pass
        except (OSError, CancelledError) as fault:
            raise _SchedulerLost from fault
        if client.status != "running":
            raise _SchedulerLost
        return [future for future in running if future.status != "pending"]

    def _result(self, future: Any, tile: int, deaths: Counter[int]) -> bytes | None:
        """Return a tile's content; None if its worker died, so that the tile must be submitted again."""
        with _scheduler_needed():
            fault = future.exception(timeout=self._patience_s) if future.status == "error" else None
            content = future.result(timeout=self._patience_s) if future.status == "finished" else None
        if fault is None and content is None:
            raise _SchedulerLost  # cancelled
        future.release()
        if not isinstance(fault, self._dask.KilledWorker):
            if fault is not None:
                raise fault
            return content
        deaths[tile] += 1
        if deaths[tile] >= _MAX_DEATHS:
            raise TileFailed(
                f"tile {tile}: {_MAX_DEATHS} workers died with it in hand; is their memory full? What is done is kept"
            )
        self._notify(f"workers died with tile {tile} in hand; it is given out again")
        return None

    def _threads(self) -> int:
        """Return the number of threads of all current workers."""
        with _scheduler_needed():
            return sum(self._client.nthreads().values())

    def _connect(self) -> None:
        started, has_notified = time.monotonic(), False
        while self._client is None:
            waited = time.monotonic() - started
            try:
                self._client = self._dask.Client(
                    self._address, timeout=max(1.0, min(5.0, self._patience_s)), set_as_default=False
                )
            except OSError as fault:
                if waited > self._patience_s:
                    raise EngineLost(
                        f"expected a dask scheduler at {self._address}, none answered for {waited:.0f} s ({fault}); "
                        "start one with `dask scheduler` and give the same command again: what is done is kept"
                    ) from fault
                if not has_notified:
                    self._notify(f"waiting for a scheduler at {self._address}, at most {self._patience_s:.0f} s")
                has_notified = True

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with ignoring(_log, "disconnecting from the scheduler", *_CONNECTION_FAULTS):
                client.close(timeout=2)


class _SchedulerLost(Exception):
    """The connection to the scheduler is lost, with all results it had not delivered."""


@contextmanager
def _scheduler_needed() -> Generator[None]:
    """Convert a broken connection to _SchedulerLost."""
    try:
        yield
    except _CONNECTION_FAULTS as fault:
        raise _SchedulerLost from fault


def _need_certificates(address: str) -> None:
    security: Any = import_module("distributed.security").Security()
    try:
        context = security.get_connection_args("client")["ssl_context"]
    except OSError as fault:
        raise StudyInputError(
            f"scheduler {address}: the certificates cannot be read ({fault}); {_CERTIFICATES}"
        ) from fault
    if context is None:
        raise StudyInputError(f"scheduler {address}: expected certificates, none are set; {_CERTIFICATES}")


def _loopback(address: str) -> bool:
    """Whether an address belongs to this machine only."""
    host = urlsplit(address).hostname or ""
    try:
        return ip_address(host).is_loopback
    except ValueError:  # usual: a name
        return host == "localhost"
