// The timeline of one camera: performance state, misses and false positives, visible fraction of each vessel.

const STATE_PX = 18, BARS_PX = 22, GAP_PX = 5, AXIS_PX = 18, MOST_ROWS_PX = 330;

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
    this.left = Math.min(110, 0.22 * width);
    this.wide = width - this.left;
    this.rowPx = Math.min(16, Math.max(3, Math.floor(MOST_ROWS_PX / Math.max(this.vessels.length, 1))));
    this.rowsTop = STATE_PX + 2 * (BARS_PX + GAP_PX) + 2 * GAP_PX;
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
    this.bars(context, STATE_PX + GAP_PX, 'missed', this.summary.missed);
    this.bars(context, STATE_PX + 2 * GAP_PX + BARS_PX, 'false', this.summary.false);
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
      columns.push({ first, stop, x: this.left + (k * this.wide) / count, wide: this.wide / count + 0.3 });
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
      const x = this.x(from), wide = ((to - from) * this.wide) / length;
      context.fillStyle = stateColour(state[from], facts.states.length);
      context.fillRect(x, 0, wide + 0.3, STATE_PX);
      const name = facts.states[state[from]];
      if (context.measureText(name).width + 8 >= wide) continue;
      const dark = facts.states.length > 1 && state[from] > (facts.states.length - 1) / 2;
      this.text(context, name, x + 4, STATE_PX / 2 + 1, wide, dark ? '--paper' : '--ink');
    }
  }

  // How many in each column of pixels: the mean of its frames, in parts of the greatest.
  bars(context, top, name, counts) {
    const most = counts.reduce((a, b) => Math.max(a, b), 0);
    this.text(context, name, 0, top + BARS_PX / 2, this.left - 6);
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
    this.text(context, `${most}`, this.left + 3, top + 7, 40);
  }

  // A vessel's visible fraction as the strength of its colour; missed below, in red.
  strip(context, vessel, top) {
    const { facts, length } = this.recording, { fraction, lost } = this.summary, high = this.rowPx - (this.rowPx > 5 ? 2 : 0.5);
    if (this.rowPx >= 10) this.text(context, facts.vessels[vessel].name, 0, top + high / 2, this.left - 6);
    context.fillStyle = colourOf('--track');
    context.fillRect(this.left, top, this.wide, high);
    for (const { first, stop, x, wide } of this.columns) {
      let seen = 0, sum = 0, missed = 0;
      for (let at = vessel * length + first; at < vessel * length + stop; at++) {
        if (Number.isNaN(fraction[at])) continue;
        seen++;
        sum += fraction[at];
        missed += lost[at];
      }
      if (!seen) continue;
      context.globalAlpha = 1;
      context.fillStyle = colourOf('--ink');
      context.fillRect(x, top, wide, high);
      context.globalAlpha = sum / seen;
      context.fillStyle = facts.colours.vessels[vessel];
      context.fillRect(x, top, wide, high);
      context.globalAlpha = missed / seen;
      context.fillStyle = facts.colours.alarm;
      context.fillRect(x, top + 0.6 * high, wide, 0.4 * high);
    }
    context.globalAlpha = 1;
  }

  axis(context) {
    const { times } = this.recording.facts, y = this.height - AXIS_PX / 2 + 2, count = Math.max(2, Math.floor(this.wide / 130));
    for (let k = 0; k <= count; k++) {
      const index = Math.round((k * (times.length - 1)) / count), text = `${Number(times[index].toFixed(1))} s`;
      const wide = context.measureText(text).width;
      this.text(context, text, Math.min(this.x(index + 0.5) - wide / 2, this.left + this.wide - wide), y, 200);
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

// States in the order of the detector file, from pale to strong.
function stateColour(state, states) {
  const part = states > 1 ? state / (states - 1) : 0;
  const [from, to] = ['--state-first', '--state-last'].map((name) => colourOf(name).match(/\d+/g).map(Number));
  return `rgb(${from.map((value, i) => Math.round(value + part * (to[i] - value)))})`;
}
