// The view from above: where the vessels are at a step, where the camera looks, and where the vessels come from.

const VECTOR_S = 360, NM_M = 1852, TRAIL_STEPS = 40, MIN_VESSEL_PX = 9, VIEW_PX = 3000, HIT_PX = 14, ABOVE_ASPECT = 2.6;
const RINGS = { nm: NM_M, cables: NM_M / 10 }, RINGS_ACROSS = 8, RING_EDGE_PX = 14, RADIUS_PX = 11, RADIUS_ROOM_PX = 32, SCALE_BAR_PX = 120;

// The layers of the plan alone: range rings, of which one is shown at a time.
const PLAN_LAYERS = [
  ['nm', 'Rings: nm', 'A', 'Range rings on the plan, in nautical miles'], ['cables', 'Rings: cables', 'E', 'Range rings on the plan, in cables'],
];

// Whether a place of anything is known: not in a labelled video.
function hasPlaces({ extent }) { return extent.flat().some((side) => side !== 0); }

class Above {
  constructor(canvas, choose) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d');
    this.placed = [];
    canvas.addEventListener('click', (event) => {
      const vessel = this.vesselAt(event.offsetX, event.offsetY);
      if (vessel !== null) choose(vessel);
    });
    canvas.addEventListener('pointermove', (event) => {
      const vessel = this.vesselAt(event.offsetX, event.offsetY);
      canvas.style.cursor = vessel === null ? '' : 'pointer';
      canvas.title = vessel === null ? '' : this.names[vessel];
    });
  }

  resize() {
    const width = this.canvas.clientWidth, ratio = this.ratio = window.devicePixelRatio || 1;
    [this.width, this.height] = [width, width / ABOVE_ASPECT];
    [this.canvas.width, this.canvas.height] = [Math.round(width * ratio), Math.round(this.height * ratio)];
    this.canvas.style.height = `${this.height}px`;
  }

  // All of the traffic, north (w2) upwards.
  fit([[x0, y0], [x1, y1]]) {
    this.scale = 0.9 * Math.min(this.width / Math.max(x1 - x0, 1), this.height / Math.max(y1 - y0, 1));
    this.middle = [(x0 + x1) / 2, (y0 + y1) / 2];
  }

  toCanvas(x, y) {
    return [this.width / 2 + (x - this.middle[0]) * this.scale, this.height / 2 - (y - this.middle[1]) * this.scale];
  }

  // `shown` are the cameras whose images are on the page, the one that was used last first; `layers` what is shown in them.
  draw(recording, shown, index, chosen, layers) {
    const { context } = this, { facts } = recording, { vessels, cameras } = recording.places(index);
    this.canvas.hidden = !hasPlaces(facts);
    this.names = facts.vessels.map(({ name }) => name);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.fit(facts.extent);
    context.fillStyle = colourOf('--track');
    context.fillRect(0, 0, this.width, this.height);
    for (const camera of new Set(shown)) if (cameras[camera]) this.view(cameras[camera]);
    facts.obstacles.forEach((rings, i) => this.area(rings, facts.colours.owners[facts.vessels.length + i]));
    const unit = Object.keys(RINGS).find((name) => layers[name]);
    const radii = unit && cameras[shown[0]] ? this.rings(cameras[shown[0]], unit, vessels.filter((place) => place).map(({ x, y }) => this.toCanvas(x, y))) : [];
    for (const camera of new Set(shown)) if (cameras[camera]) this.bearings(recording, index, camera, cameras[camera], layers);
    this.trails(recording, index, facts);
    this.courses(recording, index, vessels, facts, chosen);
    this.placed = [];
    const draw = (vessel) => vessels[vessel] && this.vessel(vessels[vessel], vessel, facts, vessel === chosen);
    for (const vessel of vessels.keys()) if (vessel !== chosen) draw(vessel);
    if (chosen !== null) draw(chosen); // over the others, with its name
    for (const name of radii) this.name(...name); // no vessel covers one
    this.scaleBar();
    if (facts.north) this.name('N ↑', this.width - 16, 16);
  }

  // The bearings of what the detector put out and of tracks, from the middle of the lower edge of each box. Exact where the
  // image is flat; a lens that distorts bends it by less than its distortion.
  bearings(recording, index, camera, { x, y, yaw, fov }, layers) {
    const { context } = this, { facts } = recording, [wide] = facts.cameras[camera].size, focal = wide / 2 / Math.tan(fov / 2);
    const drawn = layers.detections || layers.false ? recording.detections(index, camera) : [];
    const found = drawn.filter((each) => layers[each.false ? 'false' : 'detections']).map(({ box, vessel, false: nobody }) => ({ box, vessel: nobody ? null : vessel, dash: [2, 4] }));
    const tracks = facts.tracks && layers.tracks ? recording.tracks(index, camera).map(({ box, vessel }) => ({ box, vessel, dash: [9, 3] })) : [];
    const from = this.toCanvas(x, y);
    for (const { box, vessel, dash } of [...found, ...tracks].filter((each) => each.box)) {
      const bearing = yaw + Math.atan((wide / 2 - (box[0] + box[2]) / 2) / focal);
      const to = [from[0] + VIEW_PX * Math.cos(bearing), from[1] - VIEW_PX * Math.sin(bearing)];
      this.line(from, to, vessel === null ? facts.colours.alarm : facts.colours.vessels[vessel], { dash, alpha: 0.6 });
    }
  }

  // Where each vessel is after six minutes on her course, and how close the chosen one then comes to own ship.
  courses(recording, index, vessels, facts, chosen) {
    const [before, after] = [index - 1, index + 1].map((step) => (step >= 0 && step < facts.steps.length && recording.ready(step) ? step : index));
    const seconds = facts.times[after] - facts.times[before];
    if (!(seconds > 0)) return;
    const [then, next] = [before, after].map((step) => recording.places(step).vessels);
    const moves = vessels.map((place, i) => (place && then[i] && next[i] ? [(next[i].x - then[i].x) / seconds, (next[i].y - then[i].y) / seconds] : null));
    const at = (i, s) => this.toCanvas(vessels[i].x + s * moves[i][0], vessels[i].y + s * moves[i][1]);
    moves.forEach((move, i) => { if (move) this.line(at(i, 0), at(i, VECTOR_S), facts.colours.vessels[i]); });
    const carriers = facts.cameras.map((camera) => camera.carrier), own = facts.vessels.findIndex(({ name }) => carriers.includes(name));
    if (chosen === null || own < 0 || own === chosen || !moves[own] || !moves[chosen]) return;
    const apart = [vessels[chosen].x - vessels[own].x, vessels[chosen].y - vessels[own].y];
    const closing = [moves[chosen][0] - moves[own][0], moves[chosen][1] - moves[own][1]], speed2 = closing[0] ** 2 + closing[1] ** 2;
    const left = -(apart[0] * closing[0] + apart[1] * closing[1]) / speed2;
    if (!(left > 0)) return;
    const metres = Math.hypot(apart[0] + left * closing[0], apart[1] + left * closing[1]);
    this.closest = { vessel: chosen, metres, seconds: left };
    const [one, other] = [at(own, left), at(chosen, left)];
    this.line(one, other, colourOf('--ink'), { width: 2 });
    this.name(`CPA ${inMetres(metres)} (${(metres / NM_M).toFixed(2)} nm) in ${(left / 60).toFixed(1)} min`, this.width / 2, 16);
  }

  line(from, to, colour, { dash = [], alpha = 1, width = 1.2 } = {}) {
    const { context } = this;
    context.beginPath();
    context.moveTo(...from);
    context.lineTo(...to);
    context.setLineDash(dash);
    Object.assign(context, { strokeStyle: colour, lineWidth: width, globalAlpha: alpha });
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  // What the image covers, and the camera in its corner.
  view({ x, y, yaw, fov }) {
    const { context } = this, [atX, atY] = this.toCanvas(x, y);
    context.beginPath();
    context.moveTo(atX, atY);
    context.arc(atX, atY, VIEW_PX, -yaw - fov / 2, -yaw + fov / 2);
    context.closePath();
    context.fillStyle = colourOf('--sight');
    context.fill();
    context.beginPath();
    context.arc(atX, atY, 3.5, 0, 2 * Math.PI);
    context.fillStyle = colourOf('--ink');
    context.fill();
  }

  // Circles of round radii about a camera, as many on every step. Returns where their radii are to be written: each where it is
  // lowest in sight, clear of vessels and of the scale where that can be.
  rings({ x, y }, unit, vessels) {
    const { context, width, height } = this, [atX, atY] = this.toCanvas(x, y), pixels = RINGS[unit] * this.scale;
    const least = Math.hypot(width, height) / pixels / RINGS_ACROSS, power = 10 ** Math.floor(Math.log10(least));
    const step = [1, 2, 5, 10].find((each) => each * power >= least) * power;
    const farthest = Math.hypot(Math.max(atX, width - atX), Math.max(atY, height - atY)) / pixels;
    const inside = (at, end) => at > RING_EDGE_PX && at < end - RING_EDGE_PX;
    const clear = ([across, down]) => !(across < SCALE_BAR_PX && down > height - 3 * RING_EDGE_PX) && vessels.every(([a, b]) => Math.abs(a - across) > RADIUS_ROOM_PX || Math.abs(b - down) > RING_EDGE_PX);
    const names = [];
    for (let ring = 1; ring * step < farthest; ring += 1) {
      const radius = ring * step * pixels, seen = [];
      context.beginPath();
      context.arc(atX, atY, radius, 0, 2 * Math.PI);
      context.setLineDash([4, 4]);
      Object.assign(context, { strokeStyle: colourOf('--soft'), lineWidth: 1 });
      context.stroke();
      context.setLineDash([]);
      for (let degrees = 0; degrees <= 180; degrees += 0.5) { // from the lowest place to both sides
        const turn = degrees * Math.PI / 180, down = atY + radius * Math.cos(turn);
        for (const across of [atX + radius * Math.sin(turn), atX - radius * Math.sin(turn)]) {
          if (inside(across, width) && inside(down, height)) seen.push([across, down]);
        }
      }
      const place = seen.find(clear) ?? seen[0];
      if (place) names.push([`${Number((ring * step).toPrecision(6))} ${unit}`, place[0], place[1] + 4, RADIUS_PX]);
    }
    return names;
  }

  // The closed lines of an obstacle; inner ones are holes.
  area(rings, colour) {
    const { context } = this;
    context.beginPath();
    for (const ring of rings) {
      ring.forEach(([x, y], i) => (i ? context.lineTo(...this.toCanvas(x, y)) : context.moveTo(...this.toCanvas(x, y))));
      context.closePath();
    }
    context.fillStyle = colour;
    context.fill('evenodd');
  }

  // Where vessels were at the steps before, as far as they are at hand.
  trails(recording, index, { vessels, colours }) {
    const { context } = this;
    const steps = [];
    for (let step = Math.max(0, index - TRAIL_STEPS); step <= index; step++) if (recording.ready(step)) steps.push(recording.places(step).vessels);
    vessels.forEach((_, vessel) => {
      context.beginPath();
      for (const { [vessel]: place } of steps) if (place) context.lineTo(...this.toCanvas(place.x, place.y));
      Object.assign(context, { strokeStyle: colours.vessels[vessel], lineWidth: 1.5, globalAlpha: 0.6 });
      context.stroke();
      context.globalAlpha = 1;
    });
  }

  // A hull with a pointed bow, true to scale where that can be seen.
  vessel({ x, y, heading }, vessel, { dimensions, colours }, chosen) {
    const { context } = this, [atX, atY] = this.toCanvas(x, y), [length, beam] = dimensions[vessel];
    const long = Math.max(length * this.scale, MIN_VESSEL_PX), wide = Math.max(beam * this.scale, MIN_VESSEL_PX / 2.5);
    context.save();
    context.translate(atX, atY);
    context.rotate(-heading);
    context.beginPath();
    for (const [ahead, port] of [[-0.5, -0.5], [0.2, -0.5], [0.5, 0], [0.2, 0.5], [-0.5, 0.5]]) context.lineTo(ahead * long, port * wide);
    context.closePath();
    Object.assign(context, { fillStyle: colours.vessels[vessel], strokeStyle: colourOf('--ink'), lineWidth: chosen ? 2.5 : 1, lineJoin: 'miter' });
    context.fill();
    context.stroke();
    context.restore();
    if (chosen) this.name(this.names[vessel], atX, atY - Math.max(long, wide) / 2 - 5);
    this.placed.push({ vessel, x: atX, y: atY, reach: Math.max(long / 2, HIT_PX) });
  }

  name(text, x, y, px = 12) {
    const { context } = this;
    Object.assign(context, { font: `600 ${px}px system-ui, sans-serif`, textAlign: 'center', lineWidth: 3, lineJoin: 'round' });
    Object.assign(context, { strokeStyle: colourOf('--paper'), fillStyle: colourOf('--ink') });
    const half = context.measureText(text).width / 2, within = Math.min(Math.max(x, half + 3), this.width - half - 3);
    context.strokeText(text, within, Math.max(y, 12));
    context.fillText(text, within, Math.max(y, 12));
    context.textAlign = 'left';
  }

  scaleBar() {
    const { context } = this, power = 10 ** Math.floor(Math.log10(80 / this.scale));
    const metres = [5, 2, 1].map((part) => part * power).find((length) => length * this.scale <= 80), wide = metres * this.scale;
    const text = metres >= 1000 ? `${metres / 1000} km` : `${metres} m`;
    context.fillStyle = colourOf('--ink');
    context.fillRect(8, this.height - 10, wide, 2);
    context.font = '11px system-ui, sans-serif';
    context.fillText(text, 8, this.height - 14);
  }

  // The nearest vessel to a place, if it is near.
  vesselAt(x, y) {
    const far = (place) => Math.hypot(place.x - x, place.y - y), near = this.placed.filter((place) => far(place) <= place.reach);
    return near.length ? near.reduce((best, place) => (far(place) < far(best) ? place : best)).vessel : null;
  }
}
