"""Random numbers keyed by purpose, names and step, so that they do not depend on the order of calls."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from enum import Enum, unique
from functools import lru_cache

import numpy as np
from numpy.random import Generator, Philox, SeedSequence
from numpy.typing import NDArray
from scipy import special

from modsim3d.core.arrays import Array, Indices, occurring

# ---- Philox4x64-10 for many keys and counters at once, and the keys ----

Words = NDArray[np.uint64]
HalfWords = NDArray[np.uint32]
NUMBERS_PER_BLOCK = 4  # one value of the counter gives four 64-bit numbers
_ROUNDS = 10
_FACTORS = np.array([[0xD2E7470EE14C6C93], [0xCA5A826395121157]], dtype=np.uint64)
_KEY_STEPS = np.array([[0x9E3779B97F4A7C15], [0xBB67AE8584CAA73B]], dtype=np.uint64)
_HALF, _LOW = np.uint64(32), np.uint64(0xFFFF_FFFF)
_HIGH_FACTORS, _LOW_FACTORS = _FACTORS >> _HALF, _FACTORS & _LOW
_POOL = 4
_HASH, _HASH_FACTOR = 0x43B0D7E5, 0x931E8875
_KEY_HASH, _KEY_HASH_FACTOR = 0x8B51F9DD, 0x58F38DED
_MIX_FACTOR, _MIX_OTHER_FACTOR = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_MIX_SHIFT = np.uint32(16)
_BITS_BELOW_A_DOUBLE, _DOUBLE_STEP = np.uint64(11), np.float64(2**-53)


def philox(keys: Words, counters: Words) -> Words:
    """The four words of each of n blocks, in the generator's order, shape (4, n), from keys (2, n) and words 0 to 3 of
    counters, the least first (4, n). NumPy's generator counts up before its first block."""
    multiplied, others = counters[::2], counters[1::2]
    for _ in range(_ROUNDS):
        # The high word of a product of 64-bit words, from products of their halves.
        high, low = multiplied >> _HALF, multiplied & _LOW
        middle = high * _LOW_FACTORS + ((low * _LOW_FACTORS) >> _HALF)
        carried = (low * _HIGH_FACTORS + (middle & _LOW)) >> _HALF
        high_words = high * _HIGH_FACTORS + (middle >> _HALF) + carried
        multiplied, others = high_words[::-1] ^ others ^ keys, (multiplied * _FACTORS)[::-1]
        keys = keys + _KEY_STEPS
    return np.stack([multiplied, others], axis=1).reshape(4, -1)


def uniforms(keys: Words, low: Words, high: Words, first: int, count: int) -> Array:
    """Uniform numbers in [0, 1) that `np.random.Generator(np.random.Philox(...)).random` gives, shape (n, count). n
    generators have keys (n, 2), and start at word 0 of the counter `low`, which must not overflow, and word 3 `high`,
    shapes (n,); words 1 and 2 are 0. The `first` numbers of each are left out."""
    skipped, stop = first // NUMBERS_PER_BLOCK, -(-(first + count) // NUMBERS_PER_BLOCK)
    blocks = stop - skipped
    counters = np.zeros((4, len(keys) * blocks), dtype=np.uint64)
    counters[0] = (low[:, None] + np.arange(skipped + 1, stop + 1, dtype=np.uint64)).ravel()
    counters[3] = np.repeat(high, blocks)
    words = philox(np.repeat(keys.T, blocks, axis=1), counters).T.reshape(len(keys), blocks * NUMBERS_PER_BLOCK)
    start = first - skipped * NUMBERS_PER_BLOCK
    return (words[:, start : start + count] >> _BITS_BELOW_A_DOUBLE) * _DOUBLE_STEP


def seeded_keys(seed: int, spawn_keys: HalfWords) -> Words:
    """Keys that `np.random.SeedSequence(seed, spawn_key=...).generate_state(2, np.uint64)` gives, shape (n, 2), for a
    seed that is not negative and the w words of each of n spawn keys, shape (w, n)."""
    count = max(_POOL, -(-seed.bit_length() // 32))
    of_seed = np.array([seed >> 32 * place & 0xFFFF_FFFF for place in range(count)], dtype=np.uint32)[:, None]
    constants = _hash_constants(_HASH, _HASH_FACTOR, _POOL * (count + len(spawn_keys)))
    pool, used = _hashed(of_seed[:_POOL], constants[: _POOL + 1]), _POOL
    for source in range(_POOL):
        others = np.arange(_POOL) != source
        pool[others] = _mixed(pool[others], _hashed(pool[source], constants[used : used + _POOL]))
        used += _POOL - 1
    for word in (*of_seed[_POOL:], *spawn_keys):
        pool = _mixed(pool, _hashed(word, constants[used : used + _POOL + 1]))
        used += _POOL
    halves = _hashed(pool, _hash_constants(_KEY_HASH, _KEY_HASH_FACTOR, _POOL)).astype(np.uint64)
    return (halves[::2] | halves[1::2] << _HALF).T.copy()


def _hash_constants(first: int, factor: int, count: int) -> HalfWords:
    """A geometric series of 32-bit words, shape (count + 1, 1)."""
    constants = [first]
    for _ in range(count):
        constants.append(constants[-1] * factor & 0xFFFF_FFFF)
    return np.array(constants, dtype=np.uint32)[:, None]


def _hashed(words: HalfWords, constants: HalfWords) -> HalfWords:
    """Words of shape (n,) or (k, n), hashed with each pair of neighbours of k + 1 constants, shape (k, n)."""
    hashed: HalfWords = (words ^ constants[:-1]) * constants[1:]
    return hashed ^ hashed >> _MIX_SHIFT


def _mixed(words: HalfWords, others: HalfWords) -> HalfWords:
    """Two words made one, same shapes."""
    mixed: HalfWords = words * _MIX_FACTOR - others * _MIX_OTHER_FACTOR
    return mixed ^ mixed >> _MIX_SHIFT


_UNIFORMS, _GENERATOR = 0, 1  # part of the key, because the two count steps differently and would overlap
# Below so many streams, and with so many rows for each, NumPy's own generator of one stream after the other is faster.
_STREAMS_IN_TURN, _ROWS_AS_A_STREAM = 20, 25
# In turn, every stream is drawn over all the steps: so many rows may be drawn at most, and so many for each one of use.
_ROWS_DRAWN, _ROWS_DRAWN_FOR_ONE = 5_000, 8
_WORDS_KEPT = 65_536
_MIN_UNIFORM = 2.0**-54  # half the least positive uniform: replaces the 0 whose normal would be −∞
GRID = 2.0**-20  # step of the detector's numbers: coarse against the rounding of a function, fine against any noise


@unique
class Purpose(Enum):
    """Everything that modsim3d draws random numbers for: text in the key, numbers a step, meaning.

    A changed text changes the output.

    Attributes:
        width: Uniform numbers a step; None for a generator for each step, which gives as many as are needed.
        meaning: What the numbers are used for; in brackets, the names in their key.
    """

    width: int | None
    meaning: str

    AGENTS = "agents", None, "start, goals and speeds of reactive agents"
    CIRCLE_RADIUS = "circular_radius", 1, "candidates for the radius of a vessel's circle (vessel)"
    CIRCLE_START = "circular_start", 2, "rate and start phase of a vessel on a circle (vessel)"
    TRAFFIC_OWN = "traffic.own", None, "speed of a vessel of the scene file in drawn traffic (vessel)"
    TRAFFIC_ARRIVALS = "traffic.arrivals", None, "when vessels enter a lane, and how many craft an area has (section)"
    TRAFFIC_LANE = "traffic.lane", None, "each try to draw a vessel of a lane (lane, ordinal)"
    TRAFFIC_LEISURE = "traffic.leisure", None, "each try to draw a craft of an area (area, ordinal)"
    TRAFFIC_ENCOUNTER = "traffic.encounter", None, "each try to draw a vessel that meets own ship (encounter, ordinal)"
    SEA = "sea", 2, "frequency and phase of each harmonic wave of a sea"
    WAVE_ANGLES = "waves", 3, "noise of roll, pitch and yaw in waves without a spectrum (vessel)"
    IMU_NOISE = "imu_noise", 6, "noise of an inertial unit's rates and specific force (vessel)"
    IMU_BIAS = "imu_bias", 6, "offset of an inertial unit's rates and specific force (vessel)"
    AIS_PHASE = "ais.phase", 2, "phases of position and static reports since a vessel came (vessel)"
    AIS_SLOT = "ais.slot", 2, "time within its interval and loss of a report (vessel, kind of report)"
    AIS_SENSORS = "ais.sensors", 5, "noise of position, velocity and heading each second (vessel)"
    AIS_COMPASS = "ais.compass", 1, "constant error of a compass (vessel)"
    ATTITUDE_NOISE = "attitude_noise", 3, "noise of measured roll, pitch and heading (vessel)"
    ATTITUDE_BIAS = "attitude_bias", 3, "offset of measured roll, pitch and heading (vessel)"
    CHECK = "check", None, "frames that the cross-check draws (ordinal)"
    PLUGIN = "plug-in", None, "whatever a plug-in draws (name of the plug-in, names of its choice)"

    STATE = "detector.state", 1, "transitions of the performance state (camera, if each has its own chain)"
    CLASS = "detector.class", 1, "class or miss of a vessel (camera, vessel)"
    CLASS_KEPT = "detector.class_kept", 1, "whether a vessel keeps its last number for class or miss (camera, vessel)"
    CLASS_VESSEL = "detector.class_vessel", 1, "what a vessel keeps of its number for class or miss (camera, vessel)"
    BOX_ERROR = "detector.box_error", 4, "error of a box (camera, vessel)"
    BOX_ERROR_REDRAW = "detector.box_error_redraw", None, "errors in place of a rejected one (camera, vessel)"
    BOX_ERROR_VESSEL = "detector.box_error_vessel", 4, "what a vessel keeps of the error of its box (camera, vessel)"
    BOX_ERROR_PART = ("detector.box_error_part", 5, "part of a box's error that changes (camera, vessel, ordinal)")
    BOX_ERROR_PART_VESSEL = "detector.box_error_part_vessel", 5, "part of it that a vessel keeps (camera, vessel)"
    BOX_ERROR_SHAPE = "detector.box_error_shape", 1, "scale of a heavy-tailed error of a box (camera, vessel)"
    BOX_ERROR_REDRAW_SHAPE = "detector.box_error_redraw_shape", None, "scale of an error in place of a rejected one"
    MERGE = "detector.merge", 1, "whether two overlapping vessels share a box (camera, both vessels)"
    MERGE_KEPT = "detector.merge_kept", 1, "whether two vessels keep their last number for that (camera, both vessels)"
    DOUBLE = "detector.double", 2, "whether a vessel gets a second box or is split, and where (camera, vessel)"
    DUPLICATE = "detector.duplicate", 4, "error of a second box (camera, vessel)"
    DUPLICATE_REDRAW = "detector.duplicate_redraw", None, "second box's errors in place of a rejected one"
    DUPLICATE_SHAPE = "detector.duplicate_shape", 1, "scale of a heavy-tailed error of a second box (camera, vessel)"
    DUPLICATE_REDRAW_SHAPE = (
        "detector.duplicate_redraw_shape",
        None,
        "scale of a second box's error in place of a rejected one",
    )
    TRANSIENT_TRIAL = "detector.clutter_trial", 1, "success of each of the thesis's trials (camera, ordinal)"
    TRANSIENT_COUNT = "detector.clutter_count", 1, "number of transient false positives (camera)"
    TRANSIENT = "detector.clutter", 5, "place, size and label of a transient false positive (camera, ordinal)"
    PERSISTENT_BIRTHS = "detector.wanderer_births", 1, "number of births of persistent false positives (camera, layer)"
    PERSISTENT = "detector.wanderer", 8, "life of a persistent false positive (camera, layer, ordinal)"
    ON_VESSEL = "detector.on_vessel", 5, "whether a false positive lies on a vessel, and where (camera, vessel)"
    ON_VESSEL_KEPT = "detector.on_vessel_kept", 1, "whether a vessel keeps its last numbers for that (camera, vessel)"
    ON_VESSEL_CONFIDENCE = "detector.on_vessel_confidence", 2, "confidence and order of such a one (camera, vessel)"
    SCORE = "detector.score", 1, "part of a vessel's score that changes in time (camera, vessel, ordinal)"
    SCORE_WHITE = "detector.score_white", 1, "part of its score that is new at every step (camera, vessel)"
    SCORE_VESSEL = "detector.score_vessel", 1, "part of its score that a vessel keeps (camera, vessel)"
    CONFIDENCE = "detector.confidence", 2, "confidence and order of a vessel's detection (camera, vessel)"
    DUPLICATE_CONFIDENCE = "detector.duplicate_confidence", 2, "the same of a second box (camera, vessel)"
    FRAGMENT_CONFIDENCE = "detector.fragment_confidence", 2, "the same of the smaller part of a split box"
    TRANSIENT_CONFIDENCE = "detector.clutter_confidence", 2, "the same of a transient false positive (camera, ordinal)"
    PERSISTENT_CONFIDENCE = "detector.persistent_confidence", 2, "the same of a persistent one (camera, ordinal)"

    __hash__ = object.__hash__  # an `Enum` hashes its name in Python, and every number is looked up by its purpose

    def __new__(cls, text: str, width: int | None, meaning: str) -> Purpose:
        """Make the text the member's value, so that no two members may share it."""
        member = object.__new__(cls)
        member._value_, member.width, member.meaning = text, width, meaning
        return member

    @property
    def uniforms(self) -> int:
        """Uniform numbers a step.

        Raises:
            ValueError: The purpose has a generator for each step.
        """
        if self.width is None:
            raise ValueError(f"{self} has a generator for each step and no uniform numbers")
        return self.width


class Streams:
    """All random numbers of a run, made from one seed. A stream is keyed by a purpose and by names, such as those of a
    camera and a vessel. Within it each step has its own range of the counter of Philox (Salmon et al. (2011), "Parallel
    random numbers: as easy as 1, 2, 3"). The noise of a vessel at a step therefore does not depend on the other
    vessels, on how a run is split, or on the order of calls. An instance must not be shared between threads."""

    def __init__(self, seed: int) -> None:
        """Start from a seed.

        Raises:
            ValueError: The seed is negative.
        """
        self.seed = seed
        self._root = SeedSequence(seed)
        self._keys: dict[tuple[int, Purpose, tuple[str, ...]], NDArray[np.uint64]] = {}
        self._keys_of_owners: dict[tuple[int, Purpose, tuple[str, ...], tuple[str, ...]], NDArray[np.uint64]] = {}
        self._scratch = Philox(self._root)
        self._scratch_generator = Generator(self._scratch)
        self._counter = np.zeros(NUMBERS_PER_BLOCK, dtype=np.uint64)
        self._buffer = np.zeros(NUMBERS_PER_BLOCK, dtype=np.uint64)

    def uniforms(self, purpose: Purpose, *names: str, first: int, count: int) -> Array:
        """Uniform numbers in [0, 1) for `count` steps from `first` on, shape (count, width of the purpose).

        The row of a step is the same however the steps are split into calls.

        Args:
            purpose: What the numbers are used for.
            *names: Rest of the key.
            first: First step.
            count: Number of steps.

        Raises:
            ValueError: The purpose has a generator for each step.
        """
        width = purpose.uniforms
        blocks = -(-width // NUMBERS_PER_BLOCK)
        self._start(self._scratch, self._key(_UNIFORMS, purpose, names), low=first * blocks)
        return self._scratch_generator.random((count, blocks * NUMBERS_PER_BLOCK))[:, :width]

    def uniforms_of(
        self, purpose: Purpose, *names: str, owners: Sequence[str], owner: Indices, steps: Indices
    ) -> Array:
        """Uniform numbers of many streams that `uniforms` gives, shape (n, width of the purpose).

        Args:
            purpose: What the numbers are used for.
            *names: Rest of the key but for its last name.
            owners: Last names of keys.
            owner: Index of the last name of each row, shape (n,).
            steps: Step of each row, shape (n,).

        Raises:
            ValueError: The purpose has a generator for each step.
        """
        width = purpose.uniforms
        if not len(steps):
            return np.empty((0, width))
        used, place = occurring(owner, len(owners))
        first, stop = int(steps.min()), int(steps.max()) + 1
        many = len(used) > _STREAMS_IN_TURN + len(steps) // _ROWS_AS_A_STREAM
        if many or len(used) * (stop - first) > _ROWS_DRAWN + _ROWS_DRAWN_FOR_ONE * len(steps):
            blocks = -(-width // NUMBERS_PER_BLOCK)
            keys = self._keys_of(_UNIFORMS, purpose, names, owners)[owner]
            low = steps.astype(np.uint64) * np.uint64(blocks)
            return uniforms(keys, low, np.zeros_like(low), 0, width)
        parts = [
            self.uniforms(purpose, *names, owners[index], first=first, count=stop - first) for index in used.tolist()
        ]
        result: Array = np.concatenate(parts)[place * (stop - first) + (steps - first)]
        return result

    def generator(self, purpose: Purpose, *names: str, step: int) -> Generator:
        """A separate generator for one step, for an unknown number of draws; `names` are the rest of the key.

        Raises:
            ValueError: The purpose has a fixed number of uniform numbers a step.
        """
        _check_has_generators(purpose)
        bits = Philox(self._root)
        self._start(bits, self._key(_GENERATOR, purpose, names), high=step)
        return Generator(bits)

    def generated(
        self,
        purpose: Purpose,
        *names: str,
        owners: Sequence[str],
        owner: Indices,
        steps: Indices,
        first: int,
        count: int,
    ) -> Array:
        """Uniform numbers of many of the generators that `generator` gives, shape (n, count).

        Args:
            purpose: What the numbers are used for.
            *names: Rest of the key but for its last name.
            owners: Last names of keys.
            owner: Index of the last name of each of n generators, shape (n,).
            steps: Its step, shape (n,).
            first: How many numbers of each generator are left out.
            count: How many numbers of each are given.

        Raises:
            ValueError: The purpose has a fixed number of uniform numbers a step.
        """
        _check_has_generators(purpose)
        if len(steps) <= _STREAMS_IN_TURN:
            skipped, start = divmod(first, NUMBERS_PER_BLOCK)
            numbers = np.empty((len(steps), start + count))
            for row, (index, step) in enumerate(zip(owner.tolist(), steps.tolist(), strict=True)):
                key = self._key(_GENERATOR, purpose, (*names, owners[index]))
                self._start(self._scratch, key, low=skipped, high=step)
                self._scratch_generator.random(out=numbers[row])
            return numbers[:, start:]
        keys = self._keys_of(_GENERATOR, purpose, names, owners)[owner]
        low, high = np.zeros(len(steps), dtype=np.uint64), steps.astype(np.uint64)
        return uniforms(keys, low, high, first, count)

    def _start(self, bits: Philox, key: NDArray[np.uint64], low: int = 0, high: int = 0) -> None:
        """Set words 0 and 3 of Philox's counter. `Philox(key=..., counter=...)` does that too but gathers entropy."""
        self._counter[0], self._counter[3] = low, high
        bits.state = {
            "bit_generator": "Philox",
            "state": {"counter": self._counter, "key": key},
            "buffer": self._buffer,
            "buffer_pos": NUMBERS_PER_BLOCK,
            "has_uint32": 0,
            "uinteger": 0,
        }

    def _keys_of(
        self, kind: int, purpose: Purpose, names: tuple[str, ...], owners: Sequence[str]
    ) -> NDArray[np.uint64]:
        """Keys of k streams whose names differ only in the last one, its owner's, shape (k, 2)."""
        streams = (kind, purpose, names, tuple(owners))
        if streams not in self._keys_of_owners:
            spawn_keys = np.array([_spawn_key(kind, purpose, (*names, owner)) for owner in owners], dtype=np.uint32)
            self._keys_of_owners[streams] = seeded_keys(self.seed, spawn_keys.T)
        return self._keys_of_owners[streams]

    def _key(self, kind: int, purpose: Purpose, names: tuple[str, ...]) -> NDArray[np.uint64]:
        stream = (kind, purpose, names)
        if stream not in self._keys:
            sequence = SeedSequence(self.seed, spawn_key=_spawn_key(kind, purpose, names))
            self._keys[stream] = sequence.generate_state(2, np.uint64).astype(np.uint64)
        return self._keys[stream]


def _check_has_generators(purpose: Purpose) -> None:
    if purpose.width is not None:
        raise ValueError(f"{purpose} has {purpose.width} uniform numbers a step and no generator")


def normals(uniforms: Array) -> Array:
    """Standard normal numbers from uniform ones in [0, 1), of the same shape."""
    result: Array = special.ndtri(np.maximum(uniforms, _MIN_UNIFORM))
    return result


def on_grid(values: Array, step: float = GRID) -> Array:
    """Values rounded to multiples of a step, a power of two, same shape. The last bits of logarithms, exponentials and
    quantiles depend on the processor and on the versions of libraries; those of sums, products, quotients and square
    roots do not (IEEE 754). So each number that comes from such a function is rounded before anything is made of it.
    Another processor then gives another number only where the exact value lies within about 1e-16 of the middle between
    two multiples: one normal number in 10⁹."""
    return np.rint(values / step) * step


def grid_normals(uniforms: Array) -> Array:
    """Standard normal numbers as `normals` gives them, on the grid."""
    return on_grid(normals(uniforms))


def _spawn_key(kind: int, purpose: Purpose, names: tuple[str, ...]) -> tuple[int, ...]:
    """The key of a stream beside the seed, as 32-bit words."""
    return (kind, *_words(purpose.value), *(word for name in names for word in _words(name)))


@lru_cache(_WORDS_KEPT)
def _words(text: str) -> tuple[int, int]:
    """Two 32-bit words of a text; unlike `hash`, the same in every process."""
    digest = hashlib.blake2b(text.encode("utf-8"), digest_size=8).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:], "little")
