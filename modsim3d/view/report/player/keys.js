// What each key does.

function keysOf(player) {
  const { actions } = player, keys = {
    ' ': actions.play, ArrowLeft: ({ shiftKey }) => player.step(shiftKey ? -10 : -1),
    ArrowRight: ({ shiftKey }) => player.step(shiftKey ? 10 : 1),
    Home: () => player.go(0), End: () => player.go(player.recording.length - 1),
    n: actions.next, b: actions.previous, '[': () => player.faster(-1), ']': () => player.faster(1),
    c: () => player.look((player.camera + 1) % player.recording.facts.cameras.length), v: () => player.followNext(),
    '+': actions.zoomIn, '=': actions.zoomIn, '-': actions.zoomOut, 0: actions.home, 9: actions.whole, t: () => player.otherTheme(),
  };
  LAYERS.forEach(([name], i) => { keys[i + 1] = () => $(`layer-${name}`).click(); });
  if (player.lanes) keys.k = () => $('layer-tracks').click();
  return keys;
}

function listenToKeys(player) {
  const keys = keysOf(player);
  document.addEventListener('keydown', (event) => {
    const { target, key } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || target.matches('select')) return;
    if (key === ' ' && target.matches('button, input[type=checkbox], summary')) return;
    const action = keys[key.length === 1 ? key.toLowerCase() : key];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
}
