"""Hints for keys as other programs and people call them."""

import re
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from modsim3d.detector.file.schema import StateSection
from modsim3d.io import validation
from modsim3d.scene.keys import CameraKeys, MountKeys, OriginKeys, SceneKeys
from modsim3d.tracking.trackers.reference import ReferenceTracker
from modsim3d.world.vessels import VesselEntry

PACKAGE = Path(validation.__file__).parents[1]


@pytest.mark.parametrize(
    ("model", "key", "hint"),
    [
        (CameraKeys, "resolution", "did you mean 'image_size_px'?"),
        (CameraKeys, "image-Width", "did you mean 'image_size_px'?"),
        (CameraKeys, "fov", "did you mean 'hfov_deg' or 'vfov_deg'?"),
        (CameraKeys, "fps", "did you mean 'frame_rate_hz'?"),
        (CameraKeys, "pitch", "did you mean 'pose.pitch_deg' or 'mount.pitch_deg'?"),
        (CameraKeys, "skw", "did you mean 'skew'?"),
        (MountKeys, "heading", "did you mean 'yaw_deg'?"),
        (OriginKeys, "lat", "did you mean 'latitude_deg'?"),
        (SceneKeys, "actors", "did you mean 'vessels'?"),
        (VesselEntry, "width", "did you mean 'beam_m'?"),
        (VesselEntry, "mmsi", "known: length_m, beam_m, air_draft_m, label, mesh"),
        (StateSection, "recall", "did you mean 'confusion'?"),
        (ReferenceTracker, "max_age", "did you mean 'lost_s'?"),
    ],
)
def test_a_key_of_another_program_leads_to_that_of_its_section(model, key, hint):
    with pytest.raises(ValidationError) as error:
        model.model_validate({key: 1})
    assert f"{key}: unknown key ({hint})" in validation.describe(error.value, model)


def test_all_keys_that_are_suggested_are_keys_somewhere():
    source = "".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    keys = yaml.safe_load((PACKAGE / "io" / "synonyms.yaml").read_text(encoding="utf-8"))
    parts = {part for key in keys for part in key.split(".")}
    assert [part for part in parts if not re.search(rf"\b{part}(: |\")", source)] == []
