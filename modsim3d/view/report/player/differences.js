// Where two runs of the same truth differ: what the detectors of A and B made of the same vessels. It is made by run_differences.py.

const OUTCOMES = ['not annotated', 'right', 'wrong class', 'IoU below 0.5', 'off its vessel', 'missed']; // from good to bad
const LETTERS = ['A', 'B'];

class Differences {
  // `runs` are the names of the runs, each beginning with its letter.
  constructor(runs, { camera, vessel, index, long, outcomes }) {
    this.runs = runs;
    this.found = Array.from(vessel, (of, row) => ({
      camera: camera[row], vessel: of, index: index[row], until: index[row] + long[row], outcomes: [outcomes[2 * row], outcomes[2 * row + 1]],
    }));
    this.all = this.found;
  }

  // Take others; without any those of all detections.
  use(found) { this.found = found ?? this.all; }

  // Those of one camera, in order of time.
  of(camera) { return this.found.filter((each) => each.camera === camera); }

  // Those that a frame shows.
  at({ camera, index }) { return this.of(camera).filter((each) => each.index <= index && index <= each.until); }

  // Labels for the image of one run: what the other one made of a vessel.
  notes({ recording }, frame) {
    const other = recording.name === 'A' ? 1 : 0, truths = new Map(frame.truths.map((truth) => [truth.vessel, truth]));
    return this.at(frame).map(({ vessel, outcomes }) => ({
      vessel, box: truths.get(vessel).target, colour: hexOf(colourOf(`--run-${LETTERS[other].toLowerCase()}`)), text: `${LETTERS[other]}: ${OUTCOMES[outcomes[other]]}`, below: true,
    }));
  }
}

async function openDifferences() {
  return $('differences-columns') ? new Differences(JSON.parse($('runs').textContent), await unpackColumns($('differences-columns').textContent)) : null;
}

function hexOf(colour) { return `#${channels(colour).map((channel) => channel.toString(16).padStart(2, '0')).join('')}`; }
