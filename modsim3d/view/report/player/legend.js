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

// The marks of a strip of the timeline, and what they mean.
const STRIP_MARKS = [
  ['missed', 'missed', '<path d="M9 12h12v5H9z" fill="ALARM"/>'],
  ['mislabelled', 'wrong class', '<path d="M9 0h12v3H9z" fill="ALARM"/>'],
  ['bad', 'IoU below 0.5', '<path d="M9 14.5h2v2.5H9zm4 0h2v2.5h-2zm4 0h2v2.5h-2z" fill="ALARM"/>'],
  ['off', 'off its vessel', '<path d="M9 12h2v5H9zm4 0h2v5h-2zm4 0h2v5h-2z" fill="ALARM"/>'],
];

// The entries of the legend that a camera needs.
function legendOf(recording, overview) {
  const { colours, states, tracks } = recording.facts, there = ([kind]) => !overview[kind] || overview[kind].some((count) => count);
  const [colour] = colours.vessels, alarm = colourOf('--alarm'), strip = `<path d="M2 4h26v7H2z" fill="${colour}"/>`;
  const parts = [
    entries('Image', SYMBOLS.filter(there).map(([kind, text]) => [symbolOf(kind, colours), text])),
    entries('Detector', [...states.map((name, state) => [swatchOf(colours.states[state]), name]), ['weather is not drawn']]),
    entries('Strips', [
      [laneSymbol(strip), 'seen'],
      [laneSymbol(`<path d="M2 4h26v7H2z" fill="${colourOf('--hidden')}" stroke="${colourOf('--edge')}"/>`), 'hidden'],
      [laneSymbol(`<path d="M2 4h26v7H2z" fill="${colourOf('--track')}"/>`), 'out of the image'],
      ...STRIP_MARKS.filter(there).map(([, text, marks]) => [laneSymbol(strip + marks.replaceAll('ALARM', alarm)), text]),
    ]),
  ];
  if (hasPlaces(recording.facts)) parts.push(entries('Plan', planLegend(tracks)));
  if (tracks) parts.push(entries('Tracks', trackLegend(recording.facts)));
  return parts;
}

// A line of the legend: symbols and what they mean.
function entries(title, list) {
  return element('div', {}, element('span', { textContent: `${title}:` }), ...list.map((entry) => element('span', {}, ...entry)));
}

// The entries of the view from above.
function planLegend(tracks) {
  const line = (more) => `<path d="M2 9h26" stroke="${colourOf('--ink')}" ${more}/>`;
  return [
    [`<path d="M3 9L28 2v14z" fill="${colourOf('--sight')}" stroke="${colourOf('--edge')}"/>`, 'what the camera sees'],
    [line('stroke-width="1.5"'), `speed vector: way in ${VECTOR_S / 60} min`],
    [line('stroke-width="1.5" opacity="0.6"'), `way of the last ${TRAIL_STEPS} steps`],
    [line('stroke-width="1.2" stroke-dasharray="2 4"'), 'bearing of a detection'],
    ...(tracks ? [[line('stroke-width="1.2" stroke-dasharray="9 3"'), 'bearing of a track']] : []),
  ].map(([inside, text]) => [laneSymbol(inside), text]);
}

// The entries of tracks.
function trackLegend(facts) {
  const { vessels: [colour] } = facts.colours, ink = colourOf('--ink'), alarm = colourOf('--alarm'), paper = colourOf('--paper');
  return [
    [`<path d="M2 5h26v9H2z" fill="${colour}"/>`, 'track, in the colour of the vessel that it follows'],
    [`<path d="M2 5h26v9H2z" fill="${colour}" opacity="0.4"/>`, 'on a vessel that is wholly hidden or not annotated: counts neither way'],
    [`<path d="M2 5h26v5H2z" fill="${FALSE_TRACK}"/>`, `follows nothing (${facts.tracks.rule} with every vessel that is free)`],
    [`<path d="M2 13h26v3H2z" fill="${ink}"/>`, 'its vessel is less than half visible'],
    [`<path d="M10 3h10l-5 11z" fill="${alarm}" stroke="${ink}"/>`, 'identity switch: the vessel had another track before'],
    [`<path d="M10 3h10l-5 11z" fill="${paper}" stroke="${ink}"/>`, 'the track had another vessel before'],
  ].map(([inside, text]) => [laneSymbol(inside), text]);
}

function laneSymbol(inside) {
  const swatch = element('span', { className: 'symbol' });
  swatch.innerHTML = `<svg viewBox="0 0 30 18" fill="none" aria-hidden="true">${inside}</svg>`;
  return swatch;
}
