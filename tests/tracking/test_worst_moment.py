"""The moment at which a run went wrong, on hand-made truth and tracks."""

from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracking.worst_moment import FALSE, LOST, SWITCHED, Mistakes, worst_mistake, worst_moment_s
from tests.tracking.hand_made import box, hand_made

STEPS = 40


def followed(vessel: int, x: float, lost: range = range(0), switch: int = STEPS) -> tuple[list[tuple], list[tuple]]:
    """A vessel with a track on it, which is another one from a step on, but for some steps."""
    truth = [(step, vessel, box(x)) for step in range(STEPS)]
    tracks = [(step, vessel if step < switch else 50 + vessel, box(x)) for step in range(STEPS) if step not in lost]
    return truth, tracks


def scored_of(*vessels: tuple[list[tuple], list[tuple]], step_s: float = 1.0) -> ScoredRun:
    truth, tracks = ([row for vessel in vessels for row in vessel[part]] for part in (0, 1))
    return hand_made(truth, tracks, STEPS, step_s=step_s)


def test_nothing_is_wrong_where_every_vessel_is_followed_or_not_scored() -> None:
    hidden = [(step, 0, box(), 0.0) for step in range(STEPS)]
    on_it = [(step, 3, box()) for step in range(STEPS)]
    for vessel in (followed(0, 0), ([], []), (hidden, []), (hidden, on_it)):
        assert worst_moment_s(scored_of(vessel)) is None


def test_it_is_in_the_middle_of_the_time_in_which_a_vessel_is_lost() -> None:
    lost = followed(0, 0, range(20, 23))
    assert worst_moment_s(scored_of(lost)) == 21.0
    assert worst_moment_s(scored_of(lost, step_s=0.5)) == 10.5  # seconds, not steps


def test_two_vessels_that_are_lost_together_are_worse_than_one_for_longer_and_one_lost_always_hides_nothing() -> None:
    together = [followed(vessel, 100 * vessel, range(30, 33)) for vessel in (1, 2)]
    assert worst_moment_s(scored_of(followed(0, 0, range(2, 6)), *together)) == 31.0
    moment_s = worst_moment_s(scored_of(followed(0, 0, range(STEPS)), followed(1, 100, range(25, 27))))
    assert moment_s is not None and 22 <= moment_s <= 28


def test_the_time_until_new_vessels_are_followed_counts_only_where_nothing_else_is_wrong() -> None:
    late = [followed(vessel, 100 * vessel, range(3)) for vessel in range(3)]
    assert worst_moment_s(scored_of(*late)) == 0.0
    assert worst_moment_s(scored_of(*late, followed(3, 300, range(20, 22)))) == 20.0
    moment_s = worst_moment_s(scored_of(*late, followed(4, 500, range(STEPS))))
    assert moment_s is not None and moment_s >= 5  # a vessel that is 5 s old should be followed


def test_an_identity_switch_is_found_among_short_losses() -> None:
    scored = scored_of(followed(0, 0, switch=30), followed(1, 100, range(5, 7)))
    assert worst_moment_s(scored) == 30.0
    mistakes = Mistakes.of(scored)
    assert mistakes.kind.tolist() == [LOST, LOST, SWITCHED]
    assert mistakes.vessel.tolist() == [1, 1, 0]


def test_a_track_on_nothing_is_a_mistake_in_the_camera_that_has_it() -> None:
    truth, tracks = followed(0, 0)
    truth, tracks = [(2 * step, *row) for step, *row in truth], [(2 * step, *row) for step, *row in tracks]
    false = [(2 * step + 1, 7, box(400, 400)) for step in range(30, 33)]
    scored = hand_made(truth, tracks + false, STEPS, cameras=2)
    assert worst_moment_s(scored) == 31.0
    mistakes = Mistakes.of(scored)
    assert mistakes.kind.tolist() == [FALSE] * 3 and mistakes.track.tolist() == [7] * 3
    assert worst_mistake(scored, 31.0).frame.tolist() == [2 * 31 + 1]
    assert worst_mistake(scored, 12.0).frame.tolist() == [2 * 30 + 1]  # the nearest at which something is wrong
