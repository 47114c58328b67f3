// The panes of the page: one image; two cameras of a run; or the same camera of two runs, which move together.

class Stage {
  constructor(player, recordings, runs) {
    Object.assign(this, { player, recordings, panes: [], linked: recordings.length > 1 });
    for (const [number, recording] of recordings.entries()) this.add(new Pane(recording, 0, number, runs[number]));
    this.active = this.panes[0];
    const { cameras } = recordings[0].facts;
    $('besideChoice').hidden = this.linked || cameras.length < 2;
    $('beside').add(new Option('nothing', ''));
    for (const { name } of cameras) $('beside').add(new Option(name, name));
    $('beside').addEventListener('change', () => this.beside($('beside').value));
  }

  add(pane) {
    const { player } = this;
    pane.hover = new Hover(pane, player);
    for (const button of pane.node.querySelectorAll('[data-do]')) button.addEventListener('click', () => player.actions[button.dataset.do]());
    for (const kind of ['pointerdown', 'focusin', 'wheel']) pane.node.addEventListener(kind, () => this.activate(pane), { capture: true, passive: true });
    pane.select.addEventListener('change', () => player.look(Number(pane.select.value)));
    listenToPane(pane, player);
    listenOnPicture(pane, player);
    this.panes.push(pane);
  }

  // The list, the close-up, the timeline and the keys are about the pane that was used last.
  activate(pane) {
    if (this.active === pane) return;
    this.active = pane;
    this.player.changePane();
  }

  // Show a camera beside the first one, by its name; none for an empty name.
  beside(name) {
    const { cameras } = this.recordings[0].facts, camera = placeOf(name, cameras), there = this.panes[1];
    if (this.linked) return;
    $('beside').value = camera === null ? '' : name;
    if (camera === null) {
      if (!there) return;
      there.node.remove();
      this.panes.pop();
      this.active = this.panes[0];
    } else if (there) {
      there.show(camera);
    } else {
      this.add(new Pane(this.recordings[0], camera, 1));
    }
    this.player.changePane();
    this.player.home(); // it has no view before
    keepAddress(this.player);
  }

  nextBeside() {
    const names = ['', ...this.recordings[0].facts.cameras.map(({ name }) => name).filter((name) => name !== this.panes[0].facts.name)];
    this.beside(names[(names.indexOf(this.besideName ?? '') + 1) % names.length]);
  }

  // The camera beside the first one; null if there is none.
  get besideName() { return this.linked || !this.panes[1] ? null : this.panes[1].facts.name; }

  // Runs are compared through the same camera.
  look(camera) { for (const pane of this.linked ? this.panes : [this.active]) pane.show(camera); }

  home() { for (const pane of this.panes) pane.home(pane.recording.overview(pane.camera).rows); }

  resize() {
    for (const pane of this.panes) {
      pane.resize();
      pane.node.classList.toggle('active', this.panes.length > 1 && pane === this.active);
    }
  }

  // Draw all panes at a step; returns the frame of the active one.
  draw(index, { shown, followed, alarm, differences }) {
    this.frames = this.panes.map((pane) => pane.frame(index));
    if (this.linked) for (const pane of this.panes) pane.picture.view = { ...this.active.picture.view };
    this.panes.forEach((pane, i) => pane.draw(this.frames[i], shown, {
      hovered: pane.hover.find(this.frames[i], shown), chosen: chosenBox(this.frames[i], followed, pane === this.active ? alarm : null),
      notes: differences ? differences.notes(pane, this.frames[i]) : [],
    }));
    return this.frameOf(this.active);
  }

  // What a pane shows now; undefined if nothing is drawn yet.
  frameOf(pane) { return this.frames?.[this.panes.indexOf(pane)]; }

  // What the other run's detector made of the same frame; null if there is no other run.
  get otherFrame() { return this.linked ? this.frames[1 - this.panes.indexOf(this.active)] : null; }
}
