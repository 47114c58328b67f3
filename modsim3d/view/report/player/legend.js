// What the marks of the picture and of the timeline mean.

// The marks of the picture, by what the timeline counts of them, and what they mean.
const SYMBOLS = [
  ['truth', 'truth (dashed: the whole silhouette)'], ['detection', 'detection, in its vessel’s colour'],
  ...KINDS.filter(({ legend }) => legend).map(({ kind, legend }) => [kind, legend]),
];
const BOX = '<rect x="4" y="3" width="22" height="12"';

function symbolOf(kind, { alarm, truth, sea, ink, vessels: [vessel] }) {
  const inside = {
    truth: `${BOX} stroke="${truth}"/>`,
    detection: `${BOX} stroke="${vessel}" stroke-width="2"/>`,
    missed: `<path d="M3 7V2h6M21 2h6v5M27 11v5h-6M9 16H3v-5" stroke="${alarm}" stroke-width="2"/>`,
    false: `${BOX} stroke="${alarm}" stroke-width="2" stroke-dasharray="4 2.5"/><path d="M4 3l22 12M4 15l22-12" stroke="${alarm}"/>`,
    mislabelled: `${BOX} stroke="${vessel}" stroke-width="2"/><path d="M17 2h10v10z" fill="${alarm}" stroke="${ink}"/>`,
    bad: `${BOX} stroke="${vessel}" stroke-width="2" stroke-dasharray="6 4"/>`,
    off: `<rect x="21" y="2" width="7" height="6" stroke="${truth}"/><path d="M8 12l13-6" stroke="${alarm}" stroke-width="1.5"/>`
      + `<circle cx="8" cy="12" r="3" fill="${alarm}"/>`,
  };
  const swatch = element('span', { className: 'symbol' });
  swatch.innerHTML = `<svg viewBox="0 0 30 18" fill="none" aria-hidden="true"><path d="M0 0h30v18H0z" fill="${sea}"/>${inside[kind]}</svg>`;
  return swatch;
}

// The entries of the legend that a camera needs.
function legendOf(recording, summary) {
  const { colours, states } = recording.facts, parts = [];
  const add = (swatch, text) => parts.push(element('span', {}, swatch, text));
  states.forEach((name, state) => add(swatchOf(stateColour(state, states.length)), `detector: ${name}`));
  for (const [kind, text] of SYMBOLS) {
    if (!summary[kind] || summary[kind].some((count) => count)) add(symbolOf(kind, colours), text);
  }
  parts.push(element('span', { textContent:
    'Strips: a vessel’s colour while it is seen, dark while it is hidden, empty while it is out of the image; in vermilion '
    + 'below where it was missed, striped where its box was off it, lower stripes where IoU was below 0.5, above where its class was wrong.',
  }));
  if (recording.facts.tracks) parts.push(...trackLegend(recording.facts));
  return parts;
}

// The entries of tracks.
function trackLegend(facts) {
  const { vessels: [colour] } = facts.colours, parts = [];
  const add = (inside, text) => parts.push(element('span', {}, laneSymbol(inside), text));
  add(`<path d="M2 5h26v9H2z" fill="${colour}"/>`, 'track, in the colour of the vessel that it follows');
  add(`<path d="M2 5h26v9H2z" fill="${colour}" opacity="0.4"/>`, 'on a vessel that is wholly hidden or not annotated: counts neither way');
  add(`<path d="M2 5h26v5H2z" fill="${FALSE_TRACK}"/>`, `follows nothing (${facts.tracks.rule} with every vessel that is free)`);
  add(`<path d="M2 13h26v3H2z" fill="${colourOf('--ink')}"/>`, 'its vessel is less than half visible');
  add(`<path d="M10 3h10l-5 11z" fill="${colourOf('--alarm')}" stroke="${colourOf('--ink')}"/>`, 'identity switch: the vessel had another track before');
  add(`<path d="M10 3h10l-5 11z" fill="${colourOf('--paper')}" stroke="${colourOf('--ink')}"/>`, 'the track had another vessel before');
  return parts;
}

function laneSymbol(inside) {
  const swatch = element('span', { className: 'symbol' });
  swatch.innerHTML = `<svg viewBox="0 0 30 18" fill="none" aria-hidden="true">${inside}</svg>`;
  return swatch;
}
