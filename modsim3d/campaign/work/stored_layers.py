"""Layers of runs on the disk, each in a folder named by the checksum of all that decides it."""

from __future__ import annotations

import errno
import shutil
import uuid
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.campaign.file.keys import Layer
from modsim3d.errors import OutputError

CACHE_FOLDER = "cache"
"""In the folder of a campaign, unless another one is named."""
_KEY = b"modsim3d_layer"


class StoredLayers:
    """Layers in a folder that any number of processes, campaigns and machines may share.

    A layer is in `LAYER/AB/ABCD…/`, a Parquet file for each of its tables. Its folder is complete from the moment at
    which it has its name. Pages carry checksums, so that a damaged layer is noticed and made anew.
    """

    def __init__(self, folder: Path, kept: Collection[Layer]) -> None:
        """Take the folder, and the layers that are written; those that are there are read, whichever they are."""
        self._folder, self._kept = folder, frozenset(kept)

    def keeps(self, layer: Layer) -> bool:
        """Whether this layer is written."""
        return layer in self._kept

    def path(self, layer: Layer, key: str) -> Path:
        """The folder of a layer.

        Args:
            layer: Which one.
            key: The checksum of all that decides it, in hexadecimal.
        """
        return self._folder / layer / key[:2] / key

    def read(self, layer: Layer, key: str, schemas: Mapping[str, pa.Schema]) -> dict[str, pa.Table] | None:
        """The tables of a layer, by their names; None if they are not there, or are damaged."""
        folder = self.path(layer, key)
        if not folder.is_dir():
            return None
        try:
            return {name: _read(folder / f"{name}.parquet", schema, key) for name, schema in schemas.items()}
        except (OSError, ValueError, KeyError, pa.ArrowException):
            return None

    def write(self, layer: Layer, key: str, tables: Mapping[str, pa.Table]) -> None:
        """Write a layer, in place of a damaged one if there is one.

        Nothing waits for the disk here: what a machine that stops leaves half written is damaged, and made anew.

        Raises:
            OutputError: It cannot be written.
        """
        final = self.path(layer, key)
        partial = final.with_name(f".{uuid.uuid4().hex}")
        try:
            partial.mkdir(parents=True)
            for name, table in tables.items():
                _write(partial / f"{name}.parquet", table, key)
            _put_in_place(partial, final)
        except OSError as error:
            raise OutputError(f"{final} cannot be written: {error.strerror or error}") from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def _put_in_place(partial: Path, final: Path) -> None:
    """Give a complete folder its name; one that is there is damaged, or another process has made the same meanwhile.

    Raises:
        OSError: It cannot be renamed.
    """
    if final.exists():
        damaged = final.with_name(f".{uuid.uuid4().hex}")
        with suppress(FileNotFoundError):
            final.rename(damaged)
        shutil.rmtree(damaged, ignore_errors=True)
    try:
        partial.rename(final)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # another process was faster
            raise


def _write(path: Path, table: pa.Table, key: str) -> None:
    table = table.replace_schema_metadata({_KEY: key.encode()})
    with path.open("wb") as out:
        pq.write_table(table, out, compression="zstd", write_page_checksum=True)


def _read(path: Path, schema: pa.Schema, key: str) -> pa.Table:
    """A table of a layer.

    Raises:
        ValueError: It is of another layer, or has other columns.
        OSError: It cannot be read, or is damaged.
    """
    with path.open("rb") as file:
        table = pq.read_table(file, page_checksum_verification=True, use_threads=False)
    if (table.schema.metadata or {}).get(_KEY) != key.encode() or not table.schema.equals(schema):
        raise ValueError(f"{path} is of another layer")
    return table.cast(schema)  # its descriptions of columns are those of the schema
