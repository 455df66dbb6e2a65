"""Dask with certificates on both sides: the same bytes, and without them a sentence."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dask
import pytest

from studies.engines.dask_workers import DaskWorkers
from studies.engines.threads import Threads
from studies.errors import StudyInputError
from studies.running import run_study
from studies.tile_files import TileFolder
from tests.studies.small_maps import small_map

pytestmark = pytest.mark.xdist_group("dask")
OPENSSL = shutil.which("openssl")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ca.pem and NAME.pem, NAME.key of a scheduler, a worker and a client."""
    if OPENSSL is None:
        pytest.skip("certificates are made by openssl")
    place = tmp_path_factory.mktemp("certificates")

    def openssl(*arguments: str) -> None:
        subprocess.run([OPENSSL, *arguments], cwd=place, check=True, capture_output=True)

    new = ["-newkey", "rsa:2048", "-nodes", "-subj"]
    openssl("req", "-x509", *new, "/CN=ca", "-keyout", "ca.key", "-out", "ca.pem", "-days", "2")
    for name in ("scheduler", "worker", "client"):
        openssl("req", *new, f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.csr")
        signed = ["-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2"]
        openssl("x509", "-req", "-in", f"{name}.csr", *signed, "-out", f"{name}.pem")
    return place


@pytest.fixture
def address(certificates: Path, tmp_path: Path) -> Iterator[str]:
    """Of a scheduler with one worker."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    found, processes = f"tls://127.0.0.1:{port}", list[subprocess.Popen[bytes]]()

    def begin(role: str, *arguments: str) -> None:
        own = ["--tls-ca-file", "ca.pem", "--tls-cert", f"{role}.pem", "--tls-key", f"{role}.key", "--no-dashboard"]
        with (tmp_path / f"{role}.txt").open("wb") as output:
            command = [sys.executable, "-m", "dask", role, *arguments, *own]
            processes.append(subprocess.Popen(command, cwd=certificates, stdout=output, stderr=output))

    begin("scheduler", "--host", found)
    begin("worker", found, "--nthreads", "1", "--no-nanny")
    try:
        yield found
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_certificates_on_both_sides_give_the_bytes_of_this_process(
    certificates: Path, address: str, tmp_path: Path
) -> None:
    ours, theirs = (TileFolder(tmp_path / name, small_map()) for name in ("ours", "theirs"))
    run_study(ours, Threads())
    with dask.config.set(_of_client(certificates)):
        messages = list[str]()
        run_study(theirs, DaskWorkers(address, messages.append))
    for path in ours.path.glob("*.npz"):
        assert (theirs.path / path.name).read_bytes() == path.read_bytes()
    assert not any("not encrypted" in text for text in messages)


def test_without_certificates_the_error_states_what_to_set(tmp_path: Path) -> None:
    with pytest.raises(StudyInputError, match="expected certificates, none are set; set DASK_DISTRIBUTED__COMM__TLS"):
        DaskWorkers("tls://127.0.0.1:9", print)
    with (
        dask.config.set(_of_client(tmp_path)),
        pytest.raises(StudyInputError, match="the certificates cannot be read"),
    ):
        DaskWorkers("tls://127.0.0.1:9", print)


def _of_client(place: Path) -> dict[str, object]:
    """Dask's settings of a client with the certificates of a folder."""
    files = {"ca-file": "ca.pem", "client.cert": "client.pem", "client.key": "client.key"}
    own = {f"distributed.comm.tls.{key}": str(place / name) for key, name in files.items()}
    return {**own, "distributed.comm.require-encryption": True}
