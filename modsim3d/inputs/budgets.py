"""What an input may cost: every budget of the readers, each with its reason."""

from __future__ import annotations

MAX_TEXT_BYTES = 1 << 29
"""Of a file that is read as a whole: seven million poses. What is parsed from it takes up to ten times as much."""
MAX_UNPACK_RATIO = 100
"""Bytes that a gzipped file may unpack to for each of its own: tables reach 20, a file that is all one byte 1000."""
FREE_UNPACKED_BYTES = 1 << 23
"""Bytes that any gzipped file may unpack to."""
PIECE_BYTES = 1 << 20
"""Read at once. A single read would reserve memory for the whole budget."""
MAX_YAML_BYTES = 1 << 20
"""Of a scene or detector in YAML, which takes two seconds a megabyte. A thousand vessels with tracks need half."""
MAX_YAML_VALUES = 200_000
"""Once aliases and merge keys are written out, which can multiply a file of ten lines to any size."""
YAML_CHARACTERS_PER_VALUE = 64
"""A long text counts as a value for each so many characters, since an alias can repeat it too."""
MAX_JSON_VALUES = 2_000_000
"""Of a file of vessels or a scene in JSON; each takes up to 100 bytes of memory. A thousand vessels are 10,000."""
POSE_BYTES_PER_VALUE = 8
"""A pose file may have more values than that if they are as long as those of poses, which take 12 bytes each."""
MAX_POSES = 200_000_000
"""Vessels times steps, present or not: 33 bytes each in memory. Two thousand vessels for a day take 173 million."""
COCO_BYTES_PER_VALUE = 4
"""A COCO file may have more values than other JSON if they are as long as the numbers of its masks, 123.4 and 56."""
MAX_PROBLEMS = 10_000
"""Wrong entries of one file after which no more of it is read, unless they are to be left out."""
MAX_BAD_ROWS = 50_000
"""Without the cells of the header, in 16 MB of a table of AIS, after which no more is read: a third of its rows."""
MAX_LINE_CHARACTERS = 10_000
"""Of a line of numbers: MOT has ten of them, YOLO six."""
FREE_FRAMES, FRAMES_A_ROW = 100_000, 1_000
"""Frames that a MOT pair may span, and further ones for each of its lines, where no seqLength says how many there are:
three hours at 10 Hz, and a vessel every minute and a half in a longer night."""
MAX_FRAMES = 1_000_000
"""Of a MOT sequence: nine hours at 30 Hz. Learning takes 2.4 kB for each, with 300 replicates."""
MAX_PAIRS = 10_000_000
"""Of detections and annotations that could match: COCO's largest sets have two million."""
MAX_TABLE_CELLS = 15_000_000
"""Of the confusion matrices of all states with all replicates, at 50 bytes each: 220 classes with 300 replicates."""
MAX_IMAGE_BYTES = 1 << 29
"""Of an image whose size is to be known: some kinds are read as a whole for it."""
