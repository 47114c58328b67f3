"""Whatever a scene's files hold, they are read or refused."""

import copy
import re

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from modsim3d.core.errors import InputError
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import CIRCULAR, DELETED, FILES, GOOD, Inputs, places

PLACES = [(file, *path) for file in FILES for path in places(GOOD[file])]
SPOILERS = st.one_of(
    st.just(DELETED),
    st.sampled_from([None, True, "", "x", [], {}, [None], {"x": 1}, 0, -1, 1.5, 10**18, 10**400, 1e300, -1e308]),
    st.sampled_from([float("nan"), float("inf"), 5e-324, "vehicle1", "1e5", "\u2028", "a/b", "a\0", ".", "poses.json"]),
    st.floats(),
    st.integers(),
    st.text(max_size=8).filter(lambda text: text.isprintable()),
)


@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.sampled_from(PLACES), SPOILERS), min_size=1, max_size=3), st.booleans())
def test_any_mapping_is_read_or_refused_with_an_input_error(tmp_path_factory, changes, circular):
    data = copy.deepcopy(GOOD)
    if circular:
        data["scene"].update(copy.deepcopy({"poses": CIRCULAR, "steps": 5, "time_step_s": 0.5}))
        data["scene"]["cameras"].pop("shore")
    for (file, *path), value in changes:
        section = data[file]
        try:
            for key in path[:-1]:
                section = section[key]
            if value is DELETED:
                del section[path[-1]]
            else:
                section[path[-1]] = copy.deepcopy(value)
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took this place away
    scene = Inputs(tmp_path_factory.mktemp("any"), data).write()
    try:
        loaded = load_scene(scene)
    except InputError as error:
        assert error.problems
        assert all(re.match(r"[^:]", problem) for problem in error.problems)
    else:
        assert loaded.steps > 0
