// How mouse and fingers move an image.

function listenToPane(pane, player) {
  const { canvas } = pane;
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    pane.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
    player.draw();
  }, { passive: false });
  canvas.addEventListener('pointerdown', (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener('pointermove', (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    pane.move(event.movementX, event.movementY);
    player.draw();
  });
  canvas.addEventListener('dblclick', () => player.home());
}

// Press a moment to see it, and a vessel's strip or lane to see the vessel; `vesselAt` says whose strip is at a height.
function listenToTime(canvas, player, vesselAt, hint) {
  const choose = (event) => player.go(player.timeline.indexAt(event.offsetX));
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    choose(event);
    const vessel = vesselAt(event.offsetY);
    if (vessel !== null) player.follow(vessel);
  });
  canvas.addEventListener('pointermove', (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) choose(event);
    showHint(hint.element, canvas, event.offsetX, hint.text(event.offsetX, event.offsetY));
  });
  canvas.addEventListener('pointerleave', () => { hint.element.hidden = true; });
}

function showHint(hint, canvas, x, text) {
  hint.textContent = text;
  hint.hidden = false;
  hint.style.left = `${Math.max(0, Math.min(x + 12, canvas.clientWidth - hint.offsetWidth))}px`;
}
