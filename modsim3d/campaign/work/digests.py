"""Checksums of all that decides a layer: equal ones are equal layers."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import orjson

from modsim3d.detector.file.reading import content_of
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import ModsimError
from modsim3d.runs.run import VERSIONED
from modsim3d.scene.scene import Scene


def digest(*parts: Any) -> str:
    """The SHA-256 of values as JSON, in hexadecimal."""
    content = orjson.dumps(parts, option=orjson.OPT_SORT_KEYS | orjson.OPT_NON_STR_KEYS | orjson.OPT_SERIALIZE_NUMPY)
    return hashlib.sha256(content).hexdigest()


def truth_digest(scene: Scene, backend: str) -> str:
    """Of the truth: the scene without its detector, and the versions of what makes it.

    Args:
        scene: The scene.
        backend: The OpenGL context that draws it.
    """
    packages = {name: version(name) for name in VERSIONED}
    plugins = [[plugin.group, plugin.name, plugin.package, plugin.sha256] for plugin in scene.plugins]
    return digest(scene.copy.truth_sha256(), scene.seed if scene.truth_has_seed else None, packages, plugins, backend)


def plan_digest(facts: Mapping[str, Any]) -> str:
    """Of all that decides the results, given the content of `plan.json`."""
    campaign = {key: value for key, value in facts["campaign"].items() if key != "keep"}  # which decides no row
    conditions = [{key: value for key, value in each.items() if key != "values"} for each in facts["conditions"]]
    plugins = [facts["plugins"]] if facts.get("plugins") else []
    return digest(campaign, conditions, facts["versions"], *plugins)


def detector_digest(detector: DetectorModel) -> str:
    """Of a detector that was read from a file, with what was set."""
    return digest(content_of(detector))


def versions() -> dict[str, str]:
    """The version of every package that decides a row.

    Raises:
        ModsimError: TrackEval, which makes the scores, is not installed.
    """
    try:
        return {name: version(name) for name in (*VERSIONED, "trackeval")}
    except PackageNotFoundError:
        raise ModsimError('the scores of a campaign need TrackEval: pip install "modsim3d[trackers]"') from None
