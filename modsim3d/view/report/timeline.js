// The timeline of one camera: performance state, counts of what went wrong, visible fraction of each vessel.

const STATE_PX = 18, BARS_PX = 20, GAP_PX = 5, AXIS_PX = 18, MOST_ROWS_PX = 360, STRIPE_PX = 2;
const BARS = [['missed', 'missed'], ['false', 'false'], ['mislabelled', 'wrong class'], ['bad', 'IoU < 0.5'], ['off', 'off vessel']];

class Timeline {
  constructor(canvas, recording) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d');
    this.recording = recording;
    this.still = document.createElement('canvas'); // all but the playhead: drawn once a camera, size or theme
    this.summaries = [];
  }

  // Draw what does not move. Only this looks at all frames; drawing the playhead copies it.
  prepare(camera) {
    const { recording } = this, { facts } = recording;
    this.summary = this.summaries[camera] ??= recording.summary(camera);
    this.vessels = facts.vessels.map((_, vessel) => vessel).filter((vessel) => this.everSeen(vessel));
    const width = this.canvas.clientWidth;
    this.left = Math.min(132, 0.3 * width);
    this.wide = width - this.left;
    this.rowPx = Math.min(16, Math.max(3, Math.floor(MOST_ROWS_PX / Math.max(this.vessels.length, 1))));
    // Misses and false alarms always, the rest where there is some.
    const bars = BARS.filter(([kind], i) => i < 2 || this.summary[kind].some((count) => count));
    this.rowsTop = STATE_PX + bars.length * (BARS_PX + GAP_PX) + 2 * GAP_PX;
    this.height = this.rowsTop + this.vessels.length * this.rowPx + AXIS_PX;
    const ratio = this.ratio = window.devicePixelRatio || 1;
    for (const canvas of [this.canvas, this.still]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(this.height * ratio);
    }
    this.canvas.style.height = `${this.height}px`;
    const context = this.still.getContext('2d');
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = '12px system-ui, sans-serif';
    context.textBaseline = 'middle';
    this.columns = this.pixelColumns();
    this.states(context);
    bars.forEach(([kind, name], i) => this.bars(context, STATE_PX + GAP_PX + i * (BARS_PX + GAP_PX), name, this.summary[kind]));
    this.vessels.forEach((vessel, i) => this.strip(context, vessel, this.rowsTop + i * this.rowPx));
    this.axis(context);
  }

  everSeen(vessel) {
    const { length } = this.recording, { fraction } = this.summary;
    for (let at = vessel * length; at < (vessel + 1) * length; at++) if (!Number.isNaN(fraction[at])) return true;
    return false;
  }

  // First frame and the one after the last of each column of pixels, and where it is.
  pixelColumns() {
    const { length } = this.recording, count = Math.max(1, Math.min(Math.round(this.wide), length)), columns = [];
    for (let k = 0; k < count; k++) {
      const first = Math.floor((k * length) / count), stop = Math.floor(((k + 1) * length) / count);
      const x = Math.round(this.left + (k * this.wide) / count); // on whole pixels there are no seams
      columns.push({ first, stop, x, wide: Math.round(this.left + ((k + 1) * this.wide) / count) - x });
    }
    return columns;
  }

  text(context, text, x, y, most, colour = '--soft') {
    let shown = text;
    while (shown.length > 1 && context.measureText(shown).width > most) shown = `${shown.slice(0, -2)}…`;
    context.fillStyle = colourOf(colour);
    context.fillText(shown, x, y);
  }

  states(context) {
    const { state } = this.summary, { length, facts } = this.recording;
    this.text(context, 'detector', 0, STATE_PX / 2, this.left - 6);
    for (let from = 0, to = 0; from < length; from = to) {
      while (to < length && state[to] === state[from]) to++;
      if (state[from] >= facts.states.length) continue; // no frame yet
      const x = this.x(from), wide = ((to - from) * this.wide) / length;
      context.fillStyle = stateColour(state[from], facts.states.length);
      context.fillRect(x, 0, wide + 0.3, STATE_PX);
      const name = facts.states[state[from]];
      if (context.measureText(name).width + 8 >= wide) continue;
      const dark = facts.states.length > 1 && state[from] > (facts.states.length - 1) / 2;
      this.text(context, name, x + 4, STATE_PX / 2 + 1, wide, dark ? '--on-strong' : '--on-pale');
    }
  }

  // How many in each column of pixels: the mean of its frames, in parts of the greatest.
  bars(context, top, name, counts) {
    const most = counts.reduce((a, b) => Math.max(a, b), 0);
    this.text(context, most ? `${name}, up to ${most}` : `${name}: none`, 0, top + BARS_PX / 2, this.left - 6);
    context.fillStyle = colourOf('--track');
    context.fillRect(this.left, top, this.wide, BARS_PX);
    context.fillStyle = colourOf('--alarm');
    if (most) {
      for (const { first, stop, x, wide } of this.columns) {
        let sum = 0;
        for (let index = first; index < stop; index++) sum += counts[index];
        const high = (BARS_PX * sum) / (stop - first) / most;
        context.fillRect(x, top + BARS_PX - high, wide, high);
      }
    }
  }

  // A vessel's visible fraction as the strength of its colour. In vermilion below: missed; in stripes where its box is off it,
  // and lower ones where IoU is below 0.5. In vermilion above: wrong class.
  strip(context, vessel, top) {
    const { facts, length } = this.recording, high = this.rowPx - (this.rowPx > 5 ? 2 : 0.5);
    if (this.rowPx >= 9) {
      context.font = `${Math.min(12, this.rowPx)}px system-ui, sans-serif`;
      this.text(context, facts.vessels[vessel].name, 0, top + high / 2, this.left - 6);
    }
    context.fillStyle = colourOf('--track');
    context.fillRect(this.left, top, this.wide, high);
    let from = null, painted = '';
    const paint = (to) => painted && painted.split('/').forEach((part) => {
      const [colour, above, below] = part.split('@');
      context.fillStyle = colour;
      context.fillRect(from, top + above * high, to - from, (below - above) * high);
    });
    for (const { first, stop, x } of this.columns) { // neighbours of one colour are painted in one go
      const bands = this.bands(vessel, vessel * length + first, vessel * length + stop, x);
      if (bands === painted) continue;
      paint(x);
      [from, painted] = [x, bands];
    }
    paint(this.left + this.wide);
  }

  // What is painted over each other for a vessel in some frames, each as colour@top@bottom in parts of its strip.
  bands(vessel, first, stop, x) {
    const { fraction, lost, outcome } = this.summary, { facts } = this.recording, count = { seen: 0, sum: 0, missed: 0, false: 0, mislabelled: 0, bad: 0, off: 0 };
    for (let at = first; at < stop; at++) {
      if (Number.isNaN(fraction[at])) continue;
      count.seen++;
      count.sum += fraction[at];
      count.missed += lost[at];
      for (const [kind, is] of Object.entries(this.recording.mistakes(outcome[at]))) count[kind] += is;
    }
    if (!count.seen) return '';
    const hidden = channels(colourOf('--hidden')), alarm = channels(facts.colours.alarm), own = channels(facts.colours.vessels[vessel]);
    const bands = [`${mixed(hidden, own, count.sum / count.seen)}@0@1`];
    const add = (number, above, below) => number && bands.push(`${mixed(own, alarm, number / count.seen)}@${above}@${below}`);
    if (Math.floor(x / STRIPE_PX) % 2) {
      add(count.bad, 0.8, 1);
      add(count.off, 0.6, 1);
    }
    add(count.missed, 0.6, 1);
    add(count.mislabelled, 0, 0.3);
    return bands.join('/');
  }

  axis(context) {
    const { times } = this.recording.facts, y = this.height - AXIS_PX / 2 + 2, first = times[0], last = times.at(-1);
    const least = ((last - first) * 70) / this.wide, power = 10 ** Math.floor(Math.log10(least || 1));
    const apart = [1, 2, 5, 10].map((part) => part * power).find((step) => step >= least) ?? 1;
    context.font = '12px system-ui, sans-serif';
    for (let k = Math.ceil(first / apart); k * apart <= last; k++) {
      const time = Number((k * apart).toFixed(6)), text = `${time} s`, wide = context.measureText(text).width;
      const x = this.x(times.findIndex((each) => each >= time) + 0.5);
      context.fillStyle = colourOf('--line');
      context.fillRect(x, this.height - AXIS_PX, 1, 4);
      this.text(context, text, Math.min(Math.max(x - wide / 2, this.left), this.left + this.wide - wide), y + 2, 200);
    }
  }

  x(index) { return this.left + (index * this.wide) / this.recording.length; }

  indexAt(x) {
    const index = Math.floor(((x - this.left) / this.wide) * this.recording.length);
    return Math.min(Math.max(index, 0), this.recording.length - 1);
  }

  vesselAt(y) { return this.vessels[Math.floor((y - this.rowsTop) / this.rowPx)] ?? null; }

  draw(index) {
    const { context, ratio } = this, x = this.x(index + 0.5);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.still.width && this.still.height) context.drawImage(this.still, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    for (const [colour, wide] of [['--paper', 5], ['--ink', 2]]) {
      context.fillStyle = colourOf(colour);
      context.fillRect(x - wide / 2, 0, wide, this.height - AXIS_PX + 2);
    }
  }
}

let resolved = new Map();

// The colour of a CSS variable in the theme of the moment.
function colourOf(variable) {
  if (!resolved.has(variable)) {
    const probe = document.createElement('span');
    probe.style.color = `var(${variable})`;
    document.body.append(probe);
    resolved.set(variable, getComputedStyle(probe).color);
    probe.remove();
  }
  return resolved.get(variable);
}

function forgetColours() { resolved = new Map(); }

// Red, green and blue of a colour as the browser or the recording writes it.
function channels(colour) {
  if (colour.startsWith('#')) return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return colour.match(/[\d.]+/g).slice(0, 3).map(Number);
}

function mixed(from, to, part) { return `rgb(${from.map((value, i) => Math.round(value + part * (to[i] - value)))})`; }

// States in the order of the detector file, from pale to strong.
function stateColour(state, states) {
  const part = states > 1 ? state / (states - 1) : 0;
  return mixed(channels(colourOf('--state-first')), channels(colourOf('--state-last')), part);
}
