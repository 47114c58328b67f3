// The player: what is shown, and how controls change it. Each part of the page has a file of its own.

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 20, 50];

class Player {
  constructor(recording) {
    this.recording = recording;
    this.index = 0;
    this.speed = 5;
    this.playing = false;
    this.followed = null; // the vessel that is chosen, and
    this.alarm = null; // the false alarm that is: its place among the detections of the frame
    this.loop = new Loop(recording.length);
    this.shown = Object.fromEntries(LAYERS.map(([name]) => [name, name !== 'names']));
    this.drawn = { frames: 0, rows: 0, milliseconds: 0 };
    this.panes = [new Pane($('picture'), recording)];
    this.pane = this.panes[0]; // the one that the list, the close-up and the timeline are about
    this.closeup = new Closeup($('closeup'));
    this.timeline = new Timeline($('timeline'), recording);
    this.lanes = recording.facts.tracks ? new Lanes($('lanesPanel'), $('lanes'), recording, this.timeline) : null;
    this.moments = new Moments(recording);
    this.momentRow = new MomentControls(this);
    this.list = new VesselList($('vessels'), recording.facts, (vessel) => this.choose(this.followed === vessel ? null : vessel));
    this.hovers = this.panes.map((pane) => new Hover(pane, this));
    this.numbers = new Numbers(this);
    this.actions = {
      play: () => this.play(!this.playing), back: () => this.step(-1), forward: () => this.step(1),
      zoomIn: () => this.zoom(1.5), zoomOut: () => this.zoom(1 / 1.5), home: () => this.home(), whole: () => this.whole(),
      previous: () => this.momentRow.seek(-1), next: () => this.momentRow.seek(1), loop: () => this.repeat(),
      link: () => copyLink(this), save: () => savePicture(this), keys: () => this.keyHelp.toggle(),
    };
    this.fill();
    this.usual = { ...this.shown };
    this.listen();
    this.resize();
    this.momentRow.fill();
    this.home();
    if (!this.fromAddress()) this.go(Math.max(0, this.timeline.summary.seen.findIndex((seen) => seen > 0)));
    clearTimeout(writeAddress.timer); // the address stays as it is until something is done
  }

  get camera() { return this.pane.camera; }
  get picture() { return this.pane.picture; }

  // ---- what there is to choose from

  fill() {
    const { facts } = this.recording;
    $('slider').max = this.recording.length - 1;
    for (const speed of SPEEDS) $('speed').add(new Option(`${speed}×`, speed, false, speed === this.speed));
    facts.cameras.forEach(({ name }, camera) => $('camera').add(new Option(name, camera)));
    $('cameraChoice').hidden = facts.cameras.length < 2;
    LAYERS.forEach(([name, title], i) => this.addLayer(name, title, i + 1));
    if (this.lanes) {
      this.shown.tracks = true;
      this.addLayer('tracks', 'Tracks', 'K');
    }
  }

  addLayer(name, title, key) {
    const box = element('input', { type: 'checkbox', id: `layer-${name}`, checked: this.shown[name] });
    box.addEventListener('change', () => { this.shown[name] = box.checked; this.draw(); keepAddress(this); });
    $('layers').append(element('label', {}, box, ` ${title} `, element('kbd', { textContent: `${key}` })));
  }

  listen() {
    for (const button of document.querySelectorAll('[data-do]')) {
      button.addEventListener('click', () => this.actions[button.dataset.do]());
    }
    $('slider').addEventListener('input', () => this.go(Number($('slider').value)));
    $('speed').addEventListener('change', () => this.setSpeed(Number($('speed').value)));
    $('camera').addEventListener('change', () => this.look(Number($('camera').value)));
    $('theme').addEventListener('click', () => this.otherTheme());
    window.addEventListener('resize', () => this.resize());
    window.addEventListener('hashchange', () => this.fromAddress());
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.resize());
    this.keyHelp = new KeyHelp(listenToKeys(this));
    for (const pane of this.panes) listenToPane(pane, this);
    const { timeline, lanes } = this;
    const hint = { element: $('hint'), text: (x, y) => timeline.say(timeline.indexAt(x), timeline.vesselAt(y), this.camera) };
    listenToTime(timeline.canvas, this, (y) => timeline.vesselAt(y), hint);
    if (!lanes) return;
    const laneHint = { element: $('laneHint'), text: (x, y) => lanes.hint(timeline.indexAt(x), lanes.laneAt(y), this.camera) };
    listenToTime(lanes.canvas, this, (y) => lanes.vesselOf(lanes.laneAt(y), this.index), laneHint);
  }

  // ---- steps and moments

  go(index) {
    const before = this.index;
    this.index = Math.min(Math.max(index, 0), this.recording.length - 1);
    if (this.index !== before) this.alarm = null;
    this.loop.leave(this.index);
    this.draw();
    this.lanes?.reveal(this.index);
    keepAddress(this);
  }

  step(by) { this.play(false); this.go(this.index + by); }

  play(playing) {
    const paused = this.playing && !playing;
    if (playing && !this.loop.on && this.index === this.recording.length - 1) this.index = 0;
    this.playing = playing;
    $('play').textContent = playing ? '⏸ Pause' : '▶ Play';
    $('status').setAttribute('aria-live', playing ? 'off' : 'polite');
    if (paused) this.pause();
    if (!playing) return;
    this.clock = { started: performance.now(), from: this.recording.facts.times[this.index] };
    requestAnimationFrame((now) => this.tick(now));
  }

  // What waits while the run plays: the order of the list, the numbers, the address.
  pause() { this.draw(); keepAddress(this); }

  tick(now) {
    if (!this.playing) return;
    const { times } = this.recording.facts, time = this.clock.from + ((now - this.clock.started) / 1000) * this.speed;
    const { first, last } = this.loop.stretch ?? this.loop.whole;
    let index = this.index;
    while (index < last && times[index + 1] <= time) index++;
    if (index !== this.index) this.go(index);
    if (index < last) requestAnimationFrame((later) => this.tick(later));
    else if (this.loop.on) this.again(first, now);
    else this.play(false);
  }

  // From the beginning of what repeats, once its last frame was seen for as long as the one before it.
  again(first) {
    const { times } = this.recording.facts, shown = (times[this.index] - times[this.index - 1]) / this.speed;
    setTimeout(() => {
      if (!this.playing) return;
      this.go(first);
      this.play(true);
    }, Math.min(1000 * (shown || 0), 1000));
  }

  repeat() {
    this.loop.toggle();
    this.draw();
  }

  setSpeed(speed) {
    this.speed = speed;
    $('speed').value = speed;
    if (this.playing) this.play(true);
  }

  faster(by) {
    this.setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1)]);
  }

  goTo(moment) { if (moment) this.momentRow.show(moment); }

  fromAddress() {
    const { hash } = location, { facts } = this.recording, asked = partsOf(hash);
    const camera = placeOf(asked.get('camera'), facts.cameras), vessel = placeOf(asked.get('vessel'), facts.vessels);
    const index = indexInAddress(hash, facts), layers = layersInAddress(hash, this.shown);
    if (camera !== null && camera !== this.camera) this.look(camera);
    if (layers) this.show(layers);
    if (index !== null) this.go(index);
    if (vessel !== null) this.choose(vessel);
    return index !== null;
  }

  // ---- views

  look(camera) {
    this.pane.camera = camera;
    $('camera').value = camera;
    this.alarm = null;
    this.resize();
    this.momentRow.fill();
    this.home();
    keepAddress(this);
  }

  home() { this.pane.home(this.timeline.summary.rows); this.draw(); }

  whole() { this.pane.whole(); this.draw(); }

  zoom(factor) { this.pane.zoom(factor); this.draw(); }

  // A vessel, or a false alarm of this frame, or nothing.
  choose(vessel, alarm = null) {
    Object.assign(this, { followed: vessel, alarm });
    this.draw();
    if (vessel !== null) this.list.reveal(vessel);
    keepAddress(this);
  }

  follow(vessel) { this.choose(vessel); }

  followNext(by = 1) {
    const { length } = this.recording.facts.vessels, from = this.followed ?? (by > 0 ? -1 : length);
    this.choose((from + by + length) % length);
  }

  show(layers) {
    Object.assign(this.shown, layers);
    for (const name of Object.keys(layers)) $(`layer-${name}`).checked = layers[name];
    this.draw();
  }

  otherTheme() {
    const dark = matchMedia('(prefers-color-scheme: dark)').matches, now = document.documentElement.dataset.theme;
    document.documentElement.dataset.theme = (now ?? (dark ? 'dark' : 'light')) === 'dark' ? 'light' : 'dark';
    this.resize();
  }

  // ---- drawing

  resize() {
    forgetColours();
    for (const pane of this.panes) pane.resize();
    this.closeup.resize(this.pane);
    this.timeline.prepare(this.camera);
    this.lanes?.prepare(this.camera);
    $('legend').replaceChildren(...legendOf(this.recording, this.timeline.summary));
    this.draw();
  }

  draw() {
    const started = performance.now(), { recording, index, pane } = this;
    recording.rowsRead = 0;
    this.frames = this.panes.map((each) => each.frame(index));
    const frame = this.frameOf(pane);
    this.panes.forEach((each, i) => each.draw(this.frames[i], this.shown, {
      hovered: this.hovers[i].find(this.frames[i], this.shown), chosen: chosenBox(this.frames[i], this.followed, each === pane ? this.alarm : null),
    }));
    const chosen = this.closeup.draw(pane, frame, this.followed, this.shown, this.alarm);
    this.list.show(frame, pane.facts.carrier, this.playing);
    this.list.mark(chosen, this.followed);
    this.numbers.show(frame);
    this.timeline.draw(index);
    markTimeline(this.timeline, this.followed, this.loop.marked);
    this.lanes?.draw(index);
    this.say(frame, chosen);
    this.drawn = { frames: this.drawn.frames + 1, rows: recording.rowsRead, milliseconds: performance.now() - started };
  }

  // What a pane shows now.
  frameOf(pane) { return this.frames[this.panes.indexOf(pane)]; }

  // The frame, and what is close up, in words.
  say(frame, chosen) {
    const { facts } = this.recording, words = frameInWords(this.recording, frame);
    $('slider').value = this.index;
    $('slider').setAttribute('aria-valuetext', `${facts.timestamps[this.index]} seconds`);
    $('status').textContent = words;
    this.pane.canvas.setAttribute('aria-label', `Image of ${this.pane.facts.name}: ${words}`);
    const close = this.alarm !== null ? alarmInWords(frame.detections[this.alarm], facts) : chosen === null ? [] : vesselInWords(chosen, frame, facts);
    $('chosen').textContent = $('chosen').title = close.join(' · ');
    this.momentRow.mark(this.index);
  }
}
