// The player: what is shown, and how controls change it. Each part of the page has a file of its own.

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 20, 50];
const MOST_LISTED = 1000;

class Player {
  constructor(recording) {
    this.recording = recording;
    this.index = 0;
    this.speed = 5;
    this.playing = false;
    this.followed = null;
    this.shown = Object.fromEntries(LAYERS.map(([name]) => [name, name !== 'names']));
    this.drawn = { frames: 0, rows: 0, milliseconds: 0 };
    this.panes = [new Pane($('picture'), recording)];
    this.pane = this.panes[0]; // the one that the list, the close-up and the timeline are about
    this.closeup = new Closeup($('closeup'));
    this.timeline = new Timeline($('timeline'), recording);
    this.lanes = recording.facts.tracks ? new Lanes($('lanesPanel'), $('lanes'), recording, this.timeline) : null;
    this.moments = new Moments(recording);
    this.list = new VesselList($('vessels'), recording.facts, (vessel) => this.follow(this.followed === vessel ? null : vessel));
    this.actions = {
      play: () => this.play(!this.playing), back: () => this.step(-1), forward: () => this.step(1),
      zoomIn: () => this.zoom(1.5), zoomOut: () => this.zoom(1 / 1.5), home: () => this.home(), whole: () => this.whole(),
      previous: () => this.goTo(this.moments.from(this.index, -1)), next: () => this.goTo(this.moments.from(this.index, 1)),
    };
    this.fill();
    this.listen();
    this.resize();
    this.fillKinds();
    this.home();
    const { overview } = this.timeline;
    if (!this.fromAddress()) this.go(overview.firstOf(Math.max(0, overview.seen.findIndex((seen) => seen > 0))));
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
    box.addEventListener('change', () => { this.shown[name] = box.checked; this.draw(); });
    $('layers').append(element('label', {}, box, ` ${title} `, element('kbd', { textContent: `${key}` })));
  }

  // The kinds of moments that the camera has.
  fillKinds() {
    const count = ([kind]) => this.recording.momentCount(this.camera, kind), kinds = KINDS.filter(count);
    $('kind').replaceChildren(...kinds.map((kind) => new Option(`${kind[1]}: ${count(kind)}`, kind[0])));
    $('momentRow').hidden = !kinds.length;
    this.lookFor(kinds.some(([kind]) => kind === this.kind) ? this.kind : (kinds[0] ?? KINDS[0])[0]);
  }

  lookFor(kind) {
    this.kind = kind;
    $('kind').value = kind;
    const list = this.moments.look(this.camera, kind), shown = list.slice(0, MOST_LISTED);
    const options = shown.map((moment, place) => new Option(this.moments.text(moment), place));
    const more = list.length > MOST_LISTED ? ` (the first ${MOST_LISTED})` : '';
    $('moment').replaceChildren(new Option(`go to …${more}`, ''), ...options);
  }

  listen() {
    for (const button of document.querySelectorAll('[data-do]')) {
      button.addEventListener('click', () => this.actions[button.dataset.do]());
    }
    $('slider').addEventListener('input', () => this.go(Number($('slider').value)));
    $('speed').addEventListener('change', () => this.setSpeed(Number($('speed').value)));
    $('camera').addEventListener('change', () => this.look(Number($('camera').value)));
    $('kind').addEventListener('change', () => this.lookFor($('kind').value));
    $('moment').addEventListener('change', () => {
      if ($('moment').value) this.goTo(this.moments.choose(Number($('moment').value)));
    });
    $('theme').addEventListener('click', () => this.otherTheme());
    window.addEventListener('resize', () => this.resize());
    window.addEventListener('hashchange', () => this.fromAddress());
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.resize());
    listenToKeys(this);
    for (const pane of this.panes) listenToPane(pane, this);
    const { timeline, lanes } = this;
    const hint = { element: $('hint'), text: (x, y) => timeline.say(timeline.indexAt(x), timeline.vesselAt(y)) };
    listenToTime(timeline.canvas, this, (y) => timeline.vesselAt(y), hint);
    if (!lanes) return;
    const laneHint = { element: $('laneHint'), text: (x, y) => lanes.hint(timeline.indexAt(x), lanes.laneAt(y), this.camera) };
    listenToTime(lanes.canvas, this, (y) => lanes.vesselOf(lanes.laneAt(y), this.index), laneHint);
  }

  // ---- steps and moments

  // Show a step: at once if it is ready, or as soon as it is. Returns when it is shown.
  go(index) {
    this.index = Math.min(Math.max(index, 0), this.recording.length - 1);
    this.draw();
    this.lanes?.reveal(this.index);
    return this.waiting;
  }

  step(by) { this.play(false); this.go(this.index + by); }

  play(playing) {
    if (playing && this.index === this.recording.length - 1) this.index = 0;
    this.playing = playing;
    $('play').textContent = playing ? '⏸ Pause' : '▶ Play';
    $('status').setAttribute('aria-live', playing ? 'off' : 'polite');
    if (!playing) return;
    this.clock = { started: performance.now(), from: this.recording.facts.times[this.index] };
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.playing) return;
    const { times } = this.recording.facts, time = this.clock.from + ((now - this.clock.started) / 1000) * this.speed;
    let index = this.index;
    while (index + 1 < times.length && times[index + 1] <= time) index++;
    if (index !== this.index) this.go(index);
    if (index === times.length - 1) this.play(false);
    else requestAnimationFrame((later) => this.tick(later));
  }

  setSpeed(speed) {
    this.speed = speed;
    $('speed').value = speed;
    if (this.playing) this.play(true);
  }

  faster(by) {
    this.setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1)]);
  }

  // Show a moment, with its vessel close up; all of the image if it is out of sight.
  async goTo(moment) {
    if (!moment) return;
    this.play(false);
    this.followed = moment.vessel;
    await this.go(moment.index);
    if (this.index !== moment.index) return; // the user has gone on
    const found = this.recording.detections(this.index, this.camera).filter(moment.vessel === null ? (each) => each.false
      : (each) => each.vessel === moment.vessel && !each.false);
    const true_ = this.recording.truths(this.index, this.camera).filter(({ vessel }) => vessel === moment.vessel);
    const boxes = [...found.map(({ box }) => box), ...true_.map(({ full }) => full)];
    if (!boxes.every((box) => this.picture.shows(box))) this.whole();
  }

  fromAddress() {
    const index = indexInAddress(location.hash, this.recording.facts);
    if (index !== null) this.go(index);
    return index !== null;
  }

  // ---- views

  look(camera) {
    this.pane.camera = camera;
    $('camera').value = camera;
    this.resize();
    this.fillKinds();
    this.home();
  }

  home() { this.pane.home(this.timeline.overview.rows); this.draw(); }

  whole() { this.pane.whole(); this.draw(); }

  zoom(factor) { this.pane.zoom(factor); this.draw(); }

  follow(vessel) { this.followed = vessel; this.draw(); }

  followNext() { this.follow(((this.followed ?? -1) + 1) % this.recording.facts.vessels.length); }

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
    $('legend').replaceChildren(...legendOf(this.recording, this.timeline.overview));
    this.draw();
  }

  // What a step needs of each recording is made ready first.
  draw() {
    const { index } = this, recordings = new Set(this.panes.map((pane) => pane.recording));
    if (![...recordings].every((recording) => recording.ready(index))) {
      this.waiting ??= this.makeReady(recordings);
      return;
    }
    this.waiting = null;
    this.drawFrame();
    for (const recording of recordings) recording.prefetch(index);
  }

  async makeReady(recordings) {
    try {
      for (let index = -1; index !== this.index;) { // until the step is still the wanted one when it is ready
        index = this.index;
        await Promise.all([...recordings].map((recording) => recording.load(index)));
      }
      this.draw();
    } catch (error) {
      this.waiting = null;
      showFailure(error);
    }
  }

  drawFrame() {
    const started = performance.now(), { recording, index, pane } = this;
    recording.rowsRead = 0;
    const frames = this.panes.map((each) => each.frame(index)), frame = frames[this.panes.indexOf(pane)];
    this.panes.forEach((each, i) => each.draw(frames[i], this.shown));
    const chosen = this.closeup.draw(pane, frame, this.followed, this.shown);
    this.list.show(frame, pane.facts.carrier);
    this.list.mark(chosen, this.followed);
    this.timeline.draw(index);
    this.lanes?.draw(index);
    this.say(frame);
    this.drawn = { frames: this.drawn.frames + 1, rows: recording.rowsRead, milliseconds: performance.now() - started };
  }

  // The frame in words.
  say(frame) {
    const { facts } = this.recording, words = frameInWords(this.recording, frame);
    $('slider').value = this.index;
    $('slider').setAttribute('aria-valuetext', `${facts.timestamps[this.index]} seconds`);
    $('status').textContent = words;
    this.pane.canvas.setAttribute('aria-label', `Image of ${this.pane.facts.name}: ${words}`);
    const chosen = this.moments.list[this.moments.place]?.index === this.index ? `${this.moments.place}` : '';
    if ($('moment').value !== chosen) $('moment').value = chosen;
  }
}
