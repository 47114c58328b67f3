// Lanes on the time axis of the timeline, one below the other; the panel scrolls where there are many.

class LanePanel {
  constructor(panel, timeline, lanePx) {
    const canvas = panel.querySelector('canvas');
    Object.assign(this, { panel, canvas, timeline, lanePx, lanes: [], index: 0, context: canvas.getContext('2d') });
    panel.addEventListener('scroll', () => this.draw(this.index));
  }

  layOut(lanes) {
    this.lanes = lanes;
    const whole = lanes.length * this.lanePx, width = this.timeline.canvas.clientWidth;
    this.panel.firstElementChild.style.height = `${whole}px`;
    this.high = Math.min(this.panel.clientHeight, whole);
    this.ratio = window.devicePixelRatio || 1;
    [this.canvas.width, this.canvas.height] = [Math.round(width * this.ratio), Math.round(this.high * this.ratio)];
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${this.high}px` });
  }

  // Only the lanes in sight are drawn, however many there are.
  draw(index) {
    this.index = index;
    if (!this.canvas.width || !this.canvas.height) return;
    const { context, lanePx, timeline } = this, top = this.panel.scrollTop;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    Object.assign(context, { font: '11px system-ui, sans-serif', textBaseline: 'middle' });
    this.background();
    const stop = Math.min(this.lanes.length, Math.ceil((top + this.high) / lanePx));
    for (let at = Math.floor(top / lanePx); at < stop; at++) this.lane(this.lanes[at], at * lanePx - top);
    drawPlayhead(context, timeline.x(index + 0.5), this.high);
  }

  // What is behind all lanes.
  background() {}

  laneAt(y) { return this.lanes[Math.floor((y + this.panel.scrollTop) / this.lanePx)] ?? null; }
}
