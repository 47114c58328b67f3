// The player with the tracks of a tracker: their boxes in the pictures, and a panel of lanes below the timeline.

class TrackPlayer extends Player {
  fill() {
    super.fill();
    this.picture = new TrackPicture($('picture'), NARROW_PX);
    this.closeup = new TrackPicture($('closeup'));
    this.lanes = new Lanes($('lanesPanel'), $('lanes'), this.recording, this.timeline);
    this.shown.tracks = true;
    const box = element('input', { type: 'checkbox', id: 'layer-tracks', checked: true });
    box.addEventListener('change', () => { this.shown.tracks = box.checked; this.draw(); });
    $('layers').append(element('label', {}, box, ' Tracks ', element('kbd', { textContent: 'K' })));
  }

  listen() {
    super.listen();
    const canvas = $('lanes'), choose = (event) => super.go(this.timeline.indexAt(event.offsetX));
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      choose(event);
      const lane = this.lanes.laneAt(event.offsetY), vessel = lane && (this.lanes.at(lane, this.index)?.vessel ?? lane.vessel);
      if (vessel !== null) this.follow(vessel);
    });
    canvas.addEventListener('pointermove', (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) choose(event);
      this.laneHint(event.offsetX, event.offsetY);
    });
    canvas.addEventListener('pointerleave', () => { $('laneHint').hidden = true; });
  }

  key(event) {
    const { key, target, ctrlKey, metaKey, altKey } = event;
    if (key.toLowerCase() !== 'k' || ctrlKey || metaKey || altKey || target.matches('select')) return super.key(event);
    event.preventDefault();
    $('layer-tracks').click();
  }

  go(index) {
    super.go(index);
    this.lanes.reveal(this.index);
  }

  resize() {
    super.resize();
    const { cameras, tracks } = this.recording.facts, { lanes } = this, of = cameras.length > 1 ? ` of ${cameras[this.camera].name}` : '';
    $('lanesTitle').textContent = `Tracks${of}: ${lanes.of(this.camera).length} of ${tracks.name}, in the order in which they begin`;
    lanes.prepare(this.camera);
    lanes.draw(this.index);
  }

  draw() {
    super.draw();
    if (this.lanes.lanes) this.lanes.draw(this.index);
  }

  legend() {
    super.legend();
    const { vessels: [colour] } = this.recording.facts.colours, parts = [];
    const add = (inside, text) => parts.push(element('span', {}, laneSymbol(inside), text));
    add(`<path d="M2 5h26v9H2z" fill="${colour}"/>`, 'track, in the colour of the vessel that it follows');
    add(`<path d="M2 5h26v9H2z" fill="${colour}" opacity="0.4"/>`, 'on a vessel that is wholly hidden or not annotated: counts neither way');
    add(`<path d="M2 5h26v5H2z" fill="${FALSE_TRACK}"/>`, `follows nothing (${this.recording.facts.tracks.rule} with every vessel that is free)`);
    add(`<path d="M2 13h26v3H2z" fill="${colourOf('--ink')}"/>`, 'its vessel is less than half visible');
    add(`<path d="M10 3h10l-5 11z" fill="${colourOf('--alarm')}" stroke="${colourOf('--ink')}"/>`, 'identity switch: the vessel had another track before');
    add(`<path d="M10 3h10l-5 11z" fill="${colourOf('--paper')}" stroke="${colourOf('--ink')}"/>`, 'the track had another vessel before');
    $('legend').append(...parts);
  }

  laneHint(x, y) {
    const { facts } = this.recording, index = this.timeline.indexAt(x), lane = this.lanes.laneAt(y), hint = $('laneHint');
    const when = `${facts.timestamps[index]} s, step ${facts.steps[index]}: detector ${this.recording.state(index, this.camera)}`;
    hint.textContent = lane ? `${when}\n${this.lanes.say(lane, index)}` : when;
    hint.hidden = false;
    hint.style.left = `${Math.max(0, Math.min(x + 12, this.lanes.canvas.clientWidth - hint.offsetWidth))}px`;
  }
}

function laneSymbol(inside) {
  const swatch = element('span', { className: 'symbol' });
  swatch.innerHTML = `<svg viewBox="0 0 30 18" fill="none" aria-hidden="true">${inside}</svg>`;
  return swatch;
}

try {
  const recording = await openRecording();
  $('board').hidden = false;
  window.player = new TrackPlayer(recording); // for the console, and for tests
} catch (error) {
  $('failure').hidden = false;
  $('failure').textContent = `The player cannot start: ${error.message}`;
  throw error;
}
