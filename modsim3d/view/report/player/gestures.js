// How mouse and fingers move an image. One finger and a bare wheel are left to the page, which they scroll.

const SHOWN_MS = 1200, SEEK_PX = 8;

function listenToPane(pane, player) {
  const { canvas } = pane, held = new Map(); // where each button or finger that is down is, by its number
  const say = teller(canvas.parentElement.querySelector('.how'));
  canvas.addEventListener('wheel', (event) => {
    if (!event.ctrlKey && !event.metaKey) return say(`${onMac() ? '⌘' : 'Ctrl'} + wheel zooms the image`);
    event.preventDefault();
    pane.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
    player.draw();
  }, { passive: false });
  // The browser takes two fingers for its own zoom or scroll, unless it is told not to.
  for (const kind of ['touchstart', 'touchmove']) {
    canvas.addEventListener(kind, (event) => {
      if (event.touches.length > 1 && event.cancelable) event.preventDefault();
    }, { passive: false });
  }
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener('pointermove', (event) => {
    const { pointerId, clientX, clientY } = event, before = held.get(pointerId);
    if (!before) return;
    const alone = held.size === 1;
    if (alone && event.pointerType === 'touch') return say('Two fingers move and zoom the image');
    held.set(pointerId, [clientX, clientY]);
    const other = [...held.entries()].find(([id]) => id !== pointerId)?.[1];
    if (alone) pane.move(clientX - before[0], clientY - before[1]);
    else pinch(pane, before, [clientX, clientY], other);
    player.draw();
  });
  for (const kind of ['pointerup', 'pointercancel']) canvas.addEventListener(kind, (event) => held.delete(event.pointerId));
  canvas.addEventListener('dblclick', () => player.home());
}

// One of two fingers has moved: what was between them stays between them.
function pinch(pane, before, now, other) {
  const { left, top } = pane.canvas.getBoundingClientRect(), apart = (a, b) => Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1);
  pane.move((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
  pane.zoom(apart(now, other) / apart(before, other), (now[0] + other[0]) / 2 - left, (now[1] + other[1]) / 2 - top);
}

// Shows a text for a moment.
function teller(place) {
  let ends;
  return (text) => {
    place.textContent = text;
    place.hidden = false;
    clearTimeout(ends);
    ends = setTimeout(() => { place.hidden = true; }, SHOWN_MS);
  };
}

function onMac() { return /Mac|iP/.test(navigator.platform); }

// Press a moment to see it, and a vessel's strip or lane to see the vessel; `vesselAt` says whose strip is at a height.
// A finger presses when it is lifted, and seeks once it moves sideways: until then it may be about to scroll the page.
function listenToTime(canvas, player, vesselAt, hint) {
  let start = null; // of a finger that does not seek yet
  const seek = (event) => player.go(player.timeline.indexAt(event.offsetX));
  const press = (event) => {
    seek(event);
    const vessel = vesselAt(event.offsetY);
    if (vessel !== null) player.choose(vessel);
  };
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    start = event.pointerType === 'touch' ? [event.clientX, event.clientY] : null;
    if (!start) press(event);
  });
  canvas.addEventListener('pointermove', (event) => {
    const { clientX, clientY } = event;
    if (start && Math.abs(clientX - start[0]) > Math.max(SEEK_PX, Math.abs(clientY - start[1]))) start = null;
    if (start) return;
    if (canvas.hasPointerCapture(event.pointerId)) seek(event);
    showHint(hint.element, clientX, clientY, hint.text(event.offsetX, event.offsetY));
  });
  canvas.addEventListener('pointerup', (event) => {
    if (start) press(event);
    start = null;
  });
  for (const kind of ['pointerleave', 'pointercancel']) canvas.addEventListener(kind, () => { hint.element.hidden = true; });
}
