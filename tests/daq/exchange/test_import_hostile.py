"""Hostile files: none reads another file, runs code or fills the memory."""

from __future__ import annotations

import os
import socket
import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from daq.exchange import ExchangeError
from daq.exchange.columns import pick
from daq.exchange.matlab_recording import Hdf5Recording, MatRecording
from daq.exchange.recordings import open_recording


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "secret.txt"
    path.write_bytes(b"not for you" * 100)
    return path


def refused(path: Path, name: str, words: str) -> None:
    recording = open_recording(path)
    assert name in recording.names
    with pytest.raises(ExchangeError, match=words):
        recording.read([name])


def test_numbers_in_another_file_are_not_fetched(tmp_path: Path, secret: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (500,), "u1", external=[(str(secret), 0, 500)])
        file["plain"] = np.arange(5.0)
    refused(path, "x", r"in other files \('.*secret.txt'\)")
    assert open_recording(path).read(["plain"])["plain"].values.tolist() == [0, 1, 2, 3, 4]


def test_neither_are_those_put_together_of_other_datasets(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["data"] = np.arange(50.0)
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        layout = h5py.VirtualLayout((50,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "data", (50,))
        file.create_virtual_dataset("x", layout)
    refused(path, "x", "composed of other datasets")


def test_links_out_of_the_file_are_no_columns(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["data"] = np.arange(50.0)
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["out"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/data")
        file["loop"] = h5py.SoftLink("/loop")
        file["round"] = h5py.SoftLink("/")
        file["name"] = "text"
        file["reference"] = np.array([file.ref], h5py.ref_dtype)
        file["table"] = np.zeros(3, [("a", "f8"), ("b", "i4")])
        file["plain"] = np.arange(5.0)
    assert open_recording(path).names == ("plain",)


def test_a_filter_that_is_a_plug_in_is_not_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        created.set_chunk((100,))
        created.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (1,))
        space = h5py.h5s.create_simple((100,))
        h5py.h5d.create(file.id, b"x", h5py.h5t.NATIVE_DOUBLE, space, created)
    refused(path, "x", r"a filter that is not part of HDF5 \(number 32015\)")


@pytest.mark.parametrize(("shape", "chunks"), [((2**34,), (2**20,)), ((2**28,), (2**20,)), ((100,), (2**28,))])
def test_hdf5_that_would_fill_the_memory_is_refused(tmp_path: Path, shape: tuple[int], chunks: tuple[int]) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape, "f8", chunks=chunks, maxshape=(None,), compression="gzip")
    refused(path, "x", "expected (numbers|at most 4 GB)")


def test_many_columns_count_together(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for name in "abcdefghij":
            file.create_dataset(name, (2**23,), "f8", chunks=(2**20,), compression="gzip")
    recording = Hdf5Recording(path)
    assert recording.read(["a"])["a"].values.tolist()[:1] == [0.0]
    with pytest.raises(ExchangeError, match="a ratio that no recording reaches"):
        recording.read(recording.names)


def mat_element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def mat_matrix(rows: int, data: bytes) -> bytes:
    flags = mat_element(6, struct.pack("<II", 6, 0))
    return mat_element(14, flags + mat_element(5, struct.pack("<ii", rows, 1)) + mat_element(1, b"x") + data)


@pytest.mark.parametrize("inside", ["numbers", "a claim"])
def test_a_mat_bomb_is_refused(tmp_path: Path, inside: str) -> None:
    path = tmp_path / "run.mat"
    if inside == "numbers":  # 400 MB of zeros, in a cell that is not in the list of variables
        packer = zlib.compressobj(1)
        head = struct.pack("<IIII", 14, 400 * 2**20 + 8, 9, 400 * 2**20)
        packed = packer.compress(head) + b"".join(packer.compress(bytes(2**20)) for _ in range(400)) + packer.flush()
    else:
        packed = zlib.compress(mat_matrix(2**30, mat_element(9, bytes(64))))
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\0\1IM" + mat_element(15, packed))
    with pytest.raises(ExchangeError, match="a ratio that no recording reaches" if inside == "numbers" else "expected"):
        MatRecording(path)


def cells_in_cells(depth: int) -> bytes:
    """A MAT file's element: `depth` nested cells."""
    head = mat_element(6, struct.pack("<II", 1, 0)) + mat_element(5, struct.pack("<ii", 1, 1)) + mat_element(1, b"")
    heads, size = [], 0
    for _ in range(depth):
        heads.append(struct.pack("<II", 14, len(head) + size) + head)
        size += 8 + len(head)
    return b"".join(reversed(heads))


@pytest.mark.parametrize("packed", [False, True])
def test_what_would_end_the_process_is_not_given_to_the_reader(tmp_path: Path, packed: bool) -> None:
    path = tmp_path / "run.mat"

    def write(element: bytes) -> None:
        content = mat_element(15, zlib.compress(element)) if packed else element
        path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\0\1IM" + content)

    write(cells_in_cells(200_000))  # scipy calls itself for each level: a segmentation fault
    with pytest.raises(ExchangeError, match="nested cells or structs"):
        MatRecording(path)
    text = mat_element(6, struct.pack("<II", 4, 0)) + mat_element(5, struct.pack("<ii", 1, 3)) + mat_element(1, b"x")
    write(mat_element(14, text + mat_element(255, b"abc")))  # a type beyond scipy's table: another one
    with pytest.raises(ExchangeError, match=r"damaged\?"):
        MatRecording(path)
    inner = mat_matrix(2**30, mat_element(9, bytes(64)))  # a size that is not in the list of variables
    cell = mat_element(6, struct.pack("<II", 1, 0)) + mat_element(5, struct.pack("<ii", 1, 1)) + mat_element(1, b"x")
    write(mat_element(14, cell + inner))
    with pytest.raises(ExchangeError, match="at most 4 GB of numbers"):
        MatRecording(path)


def test_cells_and_structs_within_reason_are_read(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    x = np.arange(30.0)
    cells = np.array([[x, "text"], [np.empty(0), {"deep": [{"x": x}, "end"]}]], dtype=object)
    for packed in (False, True):
        savemat(path, {"data": {"x": x, "cells": cells, "z": x + 1j}, "name": "text"}, do_compression=packed)
        found = MatRecording(path)
        assert np.array_equal(found.read(["data.x"])["data.x"].values, x)
        assert found.others["data.z"].endswith("complex128")


def test_compressed_recordings_are_read_as_before(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    x = np.random.default_rng(1).standard_normal(5000)
    savemat(path, {"data": {"x": x, "still": np.zeros(100_000)}}, do_compression=True)
    assert np.array_equal(MatRecording(path).read(["data.x"])["data.x"].values, x)


def test_a_parquet_bomb_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    column = pa.DictionaryArray.from_arrays(pa.array(np.zeros(2**22, np.int8)), pa.array([1.0]))
    with pq.ParquetWriter(path, pa.schema([("x", pa.float64())]), compression="zstd") as writer:
        for _ in range(10):
            writer.write_table(pa.table({"x": column.dictionary_decode()}))
    refused(path, "x", "a ratio that no recording reaches")


def test_only_columns_of_numbers_are_read_from_parquet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.parquet"
    columns = [pa.array([[0.0] * 5]), pa.array(["a"]), pa.array([1.0]), pa.array([2.0])]
    pq.write_table(pa.Table.from_arrays(columns, ["list", "text", "x", "x"]), path)
    monkeypatch.setattr(pq, "ParquetFile", lambda _: pytest.fail("a column that may be of any size is read"))
    refused(path, "list", "expected numbers in column 'list', got list")
    refused(path, "text", "expected numbers in column 'text', got string")
    refused(path, "x", "expected one column 'x', got 2")


def test_a_line_without_an_end_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,x\n" + "0.5,1\n" * 1000 + "1" * 3_000_000)
    refused(path, "x", "line 1002: expected a row of numbers, this line has more than 1,000,000 characters")


def test_an_object_that_is_not_a_column_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(50.0)
        file["z"] = np.arange(5) + 1j
        file["stamp"] = ["2026-01-01"]
        file["cube"] = np.zeros((2, 2, 2))
        file.create_dataset("none", data=h5py.Empty("f8"))
        file["soft"] = h5py.SoftLink("/x")
        file["out"] = h5py.ExternalLink("other.h5", "/x")
    found = open_recording(path)
    assert found.names == ("x",)
    for name, words in {
        "z": "of complex128",
        "stamp": "of object",
        "cube": r"of shape \(2, 2, 2\)",
        "none": "without values",
        "soft": "a soft link",
        "out": "a link to another file",
    }.items():
        with pytest.raises(ExchangeError, match=f"x: expected a column of numbers, '{name}' is .*{words}"):
            pick(found, name, "--x")


def test_parquet_columns_in_another_file_are_not_fetched(tmp_path: Path) -> None:
    pq.write_table(pa.table({"x": np.arange(50.0)}), tmp_path / "other.parquet")
    metadata = pq.read_metadata(tmp_path / "other.parquet")
    metadata.set_file_path("other.parquet")
    metadata.write_metadata_file(tmp_path / "run.parquet")
    with pytest.raises(ExchangeError, match="cannot be read"):
        open_recording(tmp_path / "run.parquet").read(["x"])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_file_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "round.csv").symlink_to("round.csv")
    (tmp_path / "to_pipe.csv").symlink_to("pipe.csv")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket.csv"))
        for name, words in (
            ("pipe.csv", "named pipe"),
            ("to_pipe.csv", "named pipe"),
            ("socket.csv", "socket"),
            ("round.csv", "symbolic links"),
            (".", "directory"),
            ("/dev/zero", "device"),
        ):
            with pytest.raises(ExchangeError, match=words):
                open_recording(tmp_path / name)
