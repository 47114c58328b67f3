"""pycocotools reads what is exported, finds the truth perfect, and the masks are the pixels that the run counted."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pycocotools import mask as cocomask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from modsim3d.core.errors import ModsimError
from modsim3d.formats.writing import coco
from modsim3d.formats.writing.coco import Pixels, mask_entries
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.render.id_pass import Region
from modsim3d.runs.stored_run import StoredRun
from tests.formats.exported import exported_run

# pycocotools 2.0.11 under NumPy 2
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation doesn't accept a copy:DeprecationWarning")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return exported_run(tmp_path_factory.mktemp("coco"))


@pytest.fixture(scope="module")
def folder(run: StoredRun) -> Path:
    coco.write(ExportRequest(run, (0, 1), masks=True), run.folder.parent / "coco")
    return run.folder.parent / "coco"


@pytest.fixture
def truth(folder: Path) -> COCO:
    return COCO(str(folder / "gt.json"))


@pytest.mark.parametrize("kind", ["bbox", "segm"])
def test_pycocotools_finds_the_truth_perfect(truth: COCO, kind: str) -> None:
    keys = ("image_id", "category_id", "bbox", "segmentation")
    results = [{key: entry[key] for key in keys} | {"score": 1.0} for entry in truth.loadAnns(truth.getAnnIds())]
    scored = COCOeval(truth, truth.loadRes(results), kind)
    scored.evaluate()
    scored.accumulate()
    scored.summarize()
    assert scored.stats[[0, 1, 2, 8]] == pytest.approx(1)  # AP of all, 0.5 and 0.75; AR of 100 detections


def test_in_mode_0_the_mask_is_the_whole_vessel_even_of_a_hidden_one(tmp_path: Path) -> None:
    run = exported_run(tmp_path, mode=0)
    coco.write(ExportRequest(run, (0,), masks=True), tmp_path / "coco")
    entries = json.loads((tmp_path / "coco" / "gt.json").read_text())["annotations"]
    hidden = [entry for entry in entries if not entry["i_area"]]
    assert hidden
    for entry in hidden:
        assert entry["i_bbox"] == [0, 0, 0, 0] and not cocomask.decode(entry["i_segm"]).any()
        assert entry["segmentation"] == entry["a_segm"] and entry["area"] == entry["a_area"] > 0


MASKS = st.tuples(st.integers(0, 7), st.integers(0, 5), st.integers(1, 8), st.integers(1, 6), st.integers(0, 2**48))


@given(st.lists(MASKS, max_size=3))
def test_pixels_are_encoded_as_pycocotools_does(parts: list[tuple[int, ...]]) -> None:
    """Masks anywhere in an image of 9 × 7 pixels, as tiles that share none."""
    image, pieces = np.zeros((7, 9), dtype=bool), []
    for x, y, width, height, seed in parts:
        region = Region(x, y, min(width, 9 - x), min(height, 7 - y))
        place = slice(region.y, region.y + region.height), slice(region.x, region.x + region.width)
        bits = np.random.default_rng(seed).random((region.height, region.width)) < (seed % 5) / 4
        bits &= ~image[place]
        image[place] |= bits
        pieces.append((bits, region))
    pixels = Pixels.of(pieces, (9, 7))
    expected = cocomask.encode(np.asfortranarray(image.astype(np.uint8)))
    assert pixels.encoded == {"size": [7, 9], "counts": expected["counts"].decode()}
    assert pixels.area == image.sum()
    assert pixels.box == cocomask.toBbox(expected).tolist()


@given(st.lists(st.integers(1, 2**20), min_size=1, max_size=9))
def test_long_runs_are_encoded_as_pycocotools_does(counts: list[int]) -> None:
    height = 1 + len(counts) % 3
    counts[-1] += -sum(counts) % height
    size = [height, sum(counts) // height]
    expected = cocomask.frPyObjects({"size": size, "counts": counts}, *size)["counts"].decode()
    edges = np.cumsum(counts)[: len(counts) // 2 * 2]
    pixels = Pixels((size[1], size[0]), edges[0::2], edges[1::2])
    assert pixels.encoded["counts"] == expected


def test_masks_are_those_of_the_truth_table_of_each_camera_and_whole_numbers_are_whole(run, truth, folder):
    rows = sorted((r for r in run.table("truth").to_pylist() if r["annotated"]), key=lambda row: row["camera"])
    entries = truth.loadAnns(truth.getAnnIds())
    assert len(rows) == len(entries) > 100
    assert sum(row["visible_fraction"] < 1 for row in rows) > 5
    for row, entry in zip(rows, entries, strict=True):
        for key, box, count in (("a", "full", "silhouette_px"), ("i", "visible", "visible_px")):
            sides = [row[f"{box}_{side}_px"] for side in ("x_min", "y_min", "x_max", "y_max")]
            assert entry[f"{key}_area"] == cocomask.area(entry[f"{key}_segm"]) == row[count]
            x, y, width, height = entry[f"{key}_bbox"]
            assert [x, y, x + width, y + height] == sides
            assert cocomask.toBbox(entry[f"{key}_segm"]).tolist() == entry[f"{key}_bbox"]
        assert (entry["bbox"], entry["area"]) == (entry["i_bbox"], entry["i_area"])
        both = cocomask.merge([entry["a_segm"], entry["i_segm"]], intersect=True)
        assert cocomask.area(both) == entry["i_area"]
        assert truth.annToMask(entry).sum() == entry["area"]
    content = json.loads((folder / "gt.json").read_text())
    whole = {
        "images": ("id", "width", "height", "sequence"),
        "annotations": ("id", "image_id", "category_id", "iscrowd", "track_id", "area", "a_area", "i_area"),
        "categories": ("id",),
    }
    for part, keys in whole.items():
        assert content[part]
        assert {type(entry[key]) for entry in content[part] for key in keys} == {int}
    for result in json.loads((folder / "dt.json").read_text()):
        assert type(result["image_id"]) is type(result["category_id"]) is int
    both, bow, quay = (list(mask_entries(ExportRequest(run, c, masks=True))) for c in ((0, 1), (0,), (1,)))
    assert both == bow + quay
    request = ExportRequest(run, (1,), masks=True)
    (sequence,) = request.sequences
    truth = sequence.truth
    counted = truth.visible_px - (np.arange(len(truth)) == 2)
    request.__dict__["sequences"] = (replace(sequence, truth=replace(truth, visible_px=counted)),)
    with pytest.raises(ModsimError, match=r"vessel '\w+' has \d+ pixels in the image of camera 'quay.2' at step \d+"):
        list(mask_entries(request))
