// What the timeline of one camera shows: counts in bins of steps, and moments. It is made by recording/overview.py.

const COUNTED = ['seen', 'annotated', 'missed', 'false', 'mislabelled', 'bad', 'off'];
const COUNTED_OF_VESSELS = ['seen', 'fraction', 'missed', 'mislabelled', 'bad', 'off'];

// Sums over the steps of each bin, in all (`missed[bin]`) and of each vessel (`of.missed[vessel * bins + bin]`); `of.fraction` is
// in parts of the whole. A short run has a bin for each step.
class Overview {
  constructor({ width, rows }, columns, camera, length) {
    Object.assign(this, { width, length, bins: Math.ceil(length / width), state: columns[`${camera}.state`], of: {} });
    this.rows = rows ?? [Infinity, -Infinity]; // of the image: the least and the greatest that a vessel reaches
    for (const name of COUNTED) this[name] = columns[`${camera}.${name}`];
    for (const name of COUNTED_OF_VESSELS) this.of[name] = columns[`${camera}.vessels.${name}`];
    this.of.fraction = Float32Array.from(this.of.fraction, (sum) => sum / WHOLE);
  }

  binOf(index) { return Math.floor(index / this.width); }
  firstOf(bin) { return bin * this.width; }
  stopOf(bin) { return Math.min((bin + 1) * this.width, this.length); }

  // The sum of a count of a vessel over bins first to stop − 1.
  sum(name, vessel, first, stop) {
    const counts = this.of[name];
    let sum = 0;
    for (let at = vessel * this.bins + first, end = vessel * this.bins + stop; at < end; at++) sum += counts[at];
    return sum;
  }

  everSeen(vessel) { return this.sum('seen', vessel, 0, this.bins) > 0; }
}

// Moments of a kind that a camera sees, in order of time: first and last step, and whose it is, or what state begins.
function momentsIn(columns, camera, kind) {
  const [index, long, key] = ['index', 'long', 'key'].map((name) => columns[`${camera}.moments.${kind}.${name}`]);
  const moments = new Array(index.length);
  for (let i = 0; i < index.length; i++) moments[i] = { index: index[i], until: index[i] + long[i], key: key[i] === NONE ? null : key[i] };
  return moments;
}

// The numbers of the shown steps.
function stepsIn({ length, every }) {
  const steps = new Array(length);
  for (let i = 0; i < length; i++) steps[i] = i * every;
  return steps;
}

// The texts and the numbers of the times of all steps, in seconds, as recording/clock.py has stored them.
function timesIn({ clock: { decimals, first } }, { clock, clockTexts }) {
  if (clockTexts) {
    const timestamps = new TextDecoder().decode(clockTexts).split('\n');
    return { timestamps, times: Float64Array.from(timestamps, (text) => text - timestamps[0]) };
  }
  const times = new Float64Array(clock.length), one = 10 ** decimals, timestamps = new Array(clock.length);
  let units = first;
  for (let i = 0; i < clock.length; i++) {
    units += clock[i];
    const digits = `${Math.abs(units)}`.padStart(decimals + 1, '0'), whole = digits.slice(0, digits.length - decimals);
    timestamps[i] = `${units < 0 ? '-' : ''}${whole}.${digits.slice(whole.length).replace(/0+$/, '') || '0'}`;
    times[i] = (units - first) / one;
  }
  return { timestamps, times };
}
