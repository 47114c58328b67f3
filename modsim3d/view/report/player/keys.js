// What each key does: one table, from which keys act and from which the list of keys is made.

// Groups of rows; of a row `keys` says what happens at each of its keys, `shown` and `words` are for reading.
function keysOf(player) {
  const { actions } = player, count = player.recording.facts.cameras.length, row = (shown, words, keys) => ({ shown, words, keys });
  const groups = [
    { title: 'Time', keys: [
      row('space', 'play or pause', { ' ': actions.play }),
      row('← →', 'one step; with shift ten', { ArrowLeft: ({ shiftKey }) => player.step(shiftKey ? -10 : -1), ArrowRight: ({ shiftKey }) => player.step(shiftKey ? 10 : 1) }),
      row('Home End', 'first and last frame', { Home: () => player.go(0), End: () => player.go(player.recording.length - 1) }),
      row('[ ]', 'slower, faster', { '[': () => player.playback.faster(-1), ']': () => player.playback.faster(1) }),
      row('R', 'repeat: the chosen moment, or the whole run', { r: actions.loop }),
    ] },
    { title: 'Moments: with shift the one before', keys: [
      row('N B', 'next and previous moment of the chosen kind', { n: actions.next, b: actions.previous }),
      ...KINDS.filter(({ kind }) => player.differences || kind !== 'differs').map(({ kind, key, one }) => row(key.toUpperCase(), `next ${one}`, { [key]: ({ shiftKey }) => player.momentRow.seek(shiftKey ? -1 : 1, kind) })),
    ] },
    { title: 'Picture', keys: [
      ...(count < 2 ? [] : [row('C', 'next camera', { c: () => player.look((player.camera + 1) % count) })]),
      ...(player.differences || count < 2 ? [] : [row('G', 'another camera beside the first; again for the next, then none', { g: () => player.stage.nextBeside() })]),
      row('V', 'next vessel; with shift the previous one', { v: ({ shiftKey }) => player.followNext(shiftKey ? -1 : 1) }),
      row('Esc', 'choose no vessel', { Escape: () => player.choose(null) }),
      row('+ −', 'zoom', { '+': actions.zoomIn, '=': actions.zoomIn, '-': actions.zoomOut }),
      row('↑ ↓', 'on the list or the timeline: another vessel; on the image with shift and ← →: move it', {}), // focus.js has them
      row('0 9', 'where the vessels are; the whole image', { 0: actions.home, 9: actions.whole }),
      row('1 … 8', `layers: ${LAYERS.map(([, title]) => title.toLowerCase().replace('ids', 'IDs')).join(', ')}`,
        Object.fromEntries(LAYERS.map(([name], i) => [i + 1, () => $(`layer-${name}`).click()]))),
      ...(player.lanes ? [row('K', 'tracks', { k: () => $('layer-tracks').click() })] : []),
      ...(hasPlaces(player.recording.facts) ? [row('A E', 'range rings on the plan: nautical miles, cables', { a: () => $('layer-nm').click(), e: () => $('layer-cables').click() })] : []),
    ] },
    { title: 'Page', keys: [
      row('U', 'copy a link to what is shown', { u: actions.link }),
      row('P', 'save the picture', { p: actions.save }),
      row('D', 'numbers of this frame', { d: () => player.numbers.toggle() }),
      row('T', 'light or dark, in place of what the system prefers', { t: () => player.otherTheme() }),
      row('?', 'this list', { '?': actions.keys }),
    ] },
  ];
  return groups;
}

function listenToKeys(player) {
  const groups = keysOf(player), keys = Object.assign({}, ...groups.flatMap((group) => group.keys.map((row) => row.keys)));
  document.addEventListener('keydown', (event) => {
    const { target, key } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || target.matches('select, textarea, input[type=search]')) return;
    if (document.querySelector('dialog[open]') && key !== '?') return;
    if (key === ' ' && target.matches('button, input[type=checkbox], summary')) return;
    if (/^(Arrow|Home|End)/.test(key) && target === $('least')) return; // they move that slider
    const action = keys[key.length === 1 ? key.toLowerCase() : key];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
  return groups;
}
