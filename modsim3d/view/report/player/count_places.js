// The places of the page that have counts over the whole run: tiles and tables.

const whole = (count) => count.toLocaleString('en');
// Half a tenth goes to the even one, as in Python.
const tenths = (percents) => (percents % 1 === 0.25 ? percents - 0.05 : percents).toFixed(1);
const shareOf = (part, all) => (all ? `${tenths(100 * (part / all))}\u00a0%` : '–');
const ofTrue = (name) => [(tally) => whole(tally[name]), (tally) => `${shareOf(tally[name], tally.right)} of ${whole(tally.right)} true detections`];

// By the name of a tile, a row or a column: the count of a tally as text, and what it is a share of.
const COUNT_TEXTS = {
  Frames: [({ frames }) => whole(frames)], 'Vessels in frames': [({ vessels }) => whole(vessels)],
  'Partly hidden': [({ partly }) => whole(partly), ({ partly, vessels }) => `${shareOf(partly, vessels)} of vessels in frames`],
  'Wholly hidden': [({ wholly }) => whole(wholly)], Annotated: [({ annotated }) => whole(annotated)],
  Detected: [({ detected }) => whole(detected), ({ detected, annotated }) => `${shareOf(detected, annotated)} of annotated`],
  Missed: [({ annotated, detected }) => whole(annotated - detected), ({ annotated, detected }) => `${shareOf(annotated - detected, annotated)} of annotated`],
  'False positives': [(tally) => whole(tally.false), (tally) => `${shareOf(tally.false, tally.right + tally.false)} of ${whole(tally.right + tally.false)} detections`],
  'Wrong class': ofTrue('mislabelled'), 'IoU below 0.5': ofTrue('bad'), 'Off its vessel': ofTrue('off'), 'Off their vessel': ofTrue('off'),
  'Miss rate': [({ annotated, detected }) => shareOf(annotated - detected, annotated)],
  'Share of detections': [(tally) => shareOf(tally.false, tally.right + tally.false)],
};
const PAIRED = { Annotated: 'annotated', 'Detected by both': 'both', 'Only by A': 'a', 'Only by B': 'b', 'By neither': 'neither' };
const GROUPS = { Camera: 'camera', 'Performance state': 'state', Vessel: 'vessel' };

// Each place with what it shows of the run, and its text from the tallies of the recordings.
function countPlaces() {
  const places = [], add = (element, text) => { if (element && text) places.push({ element, text, before: element.innerHTML }); };
  const named = (name, cells) => cells.forEach((cell, i) => add(cell, COUNT_TEXTS[name]?.[i % 2] && ((tallies) => COUNT_TEXTS[name][i % 2](tallies[i >> 1].all))));
  for (const tile of document.querySelectorAll('.result div')) named(tile.querySelector('dt').textContent, [...tile.querySelectorAll('dd')]);
  const seen = { camera: 0, state: 0, vessel: 0 };
  for (const table of document.querySelectorAll('section table')) {
    const heads = [...(table.tHead?.rows[0].cells ?? [])].map((cell) => cell.textContent), group = GROUPS[heads[0]], rows = [...table.tBodies[0].rows];
    if (table.closest('section').querySelector('h2')?.textContent === 'What happened') {
      for (const { cells: [name, ...cells] } of rows) named(name.textContent, cells);
    } else if (heads.includes('Only by A')) {
      rows.forEach(({ cells }, at) => heads.forEach((head, i) => add(cells[i], PAIRED[head] && ((_, { paired }) => whole(paired[at][PAIRED[head]])))));
    } else if (group) {
      const run = seen[group]++;
      rows.forEach(({ cells }, at) => heads.forEach((head, i) => add(cells[i], COUNT_TEXTS[head] && ((tallies) => COUNT_TEXTS[head][0](tallies[run][group][at])))));
    }
  }
  if ($('differing')) add($('differing'), (_, { found }) => (found.length === 1 ? 'once' : `${whole(found.length)} times`));
  return places;
}

// Write the counts of tallies into the places; without any those that the run has.
function fillPlaces(places, tallies, differing) {
  for (const { element, text, before } of places) {
    if (!tallies) element.innerHTML = before;
    else if (element.querySelector('b')) element.lastChild.data = ` ${text(tallies, differing)}`; // behind the letter of the run
    else element.textContent = text(tallies, differing);
  }
}
