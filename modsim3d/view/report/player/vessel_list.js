// The list of vessels: what became of each in the frame. It can be searched, filtered and sorted.

const NAMES = new Intl.Collator('en', { numeric: true });
const ORDERS = { // what the rows are sorted by
  name: ({ name }) => name, distance: ({ truth }) => truth?.depth ?? Infinity,
  seen: ({ truth }) => (truth ? truth.fraction ?? 1 : Infinity), outcome: (row) => rankOf(row),
};
const FILTERS = {
  all: () => true, here: ({ truth }) => truth, missed: ({ truth }) => truth?.missed, wrong: (row) => isWrong(row),
};

function isWrong({ truth, found }) { return Boolean(truth?.missed || found?.mislabelled || found?.bad || found?.off); }

// The worst first: missed, wrong, detected, hidden or not annotated, not in the image.
function rankOf(row) {
  const { truth } = row;
  return !truth ? 4 : truth.missed ? 0 : isWrong(row) ? 1 : truth.detected ? 2 : 3;
}

class VesselList {
  constructor(body, facts, choose) {
    Object.assign(this, { body, facts, order: null, falling: false, frozen: false, shown: [] });
    this.rows = facts.vessels.map(({ name, label }, vessel) => {
      const button = element('button', { type: 'button', title: name }, swatchOf(facts.colours.vessels[vessel]), name);
      button.addEventListener('click', () => choose(vessel));
      const cells = ['', '', ''].map(() => element('td')), row = element('tr', {}, element('td', {}, button), ...cells);
      return { vessel, name, text: `${name} ${label}`.toLowerCase(), row, button, cells, truth: undefined, found: undefined };
    });
    $('find').addEventListener('input', () => this.arrange());
    $('which').addEventListener('change', () => this.arrange());
    for (const button of document.querySelectorAll('[data-order]')) button.addEventListener('click', () => this.sortBy(button.dataset.order));
    this.arrange();
  }

  // Rising, then falling, then as usual: what went wrong first, then who is in the image, in the order of the scene.
  sortBy(order) {
    if (this.order !== order) [this.order, this.falling] = [order, false];
    else if (!this.falling) this.falling = true;
    else [this.order, this.falling] = [null, false];
    for (const { dataset, parentElement: head } of document.querySelectorAll('[data-order]')) {
      if (dataset.order === this.order) head.setAttribute('aria-sort', this.falling ? 'descending' : 'ascending');
      else head.removeAttribute('aria-sort');
    }
    this.arrange();
  }

  // Which rows are there and in which order; rows that are where they should be are left alone.
  arrange() {
    const sought = $('find').value.trim().toLowerCase(), passes = FILTERS[$('which').value];
    const kept = this.rows.filter((row) => row.text.includes(sought) && passes(row));
    const key = ORDERS[this.order ?? 'outcome'], sign = this.falling ? -1 : 1;
    const compare = (a, b) => (typeof a === 'string' ? NAMES.compare(a, b) : a === b ? 0 : a - b);
    // Vessels that are not in the image stay at the end, whichever way the others are sorted.
    kept.sort((a, b) => (this.order === 'name' ? 0 : !a.truth - !b.truth) || sign * compare(key(a), key(b)) || a.vessel - b.vessel);
    $('listed').textContent = kept.length < this.rows.length ? `${kept.length} of ${this.rows.length}` : '';
    if (kept.length === this.shown.length && kept.every((row, i) => row === this.shown[i])) return;
    this.shown = kept;
    const focused = document.activeElement;
    this.body.replaceChildren(...kept.map(({ row }) => row));
    if (this.body.contains(focused)) focused.focus({ preventScroll: true });
  }

  // While a run plays, rows stay where they are; they are sorted and filtered anew when it pauses.
  // `other` is the same frame of another run.
  show(frame, carrier, playing, other) {
    const truths = new Map(frame.truths.map((truth) => [truth.vessel, truth]));
    const detections = new Map(frame.detections.filter((each) => !each.false).map((each) => [each.vessel, each]));
    for (const each of this.rows) {
      const truth = each.truth = truths.get(each.vessel), found = each.found = detections.get(each.vessel);
      const texts = truth ? describe(truth, found) : ['', '', each.name === carrier ? 'carries the camera' : 'not in the image'];
      if (truth && other) texts[2] = this.both(each, other);
      each.cells[2].classList.toggle('differs', Boolean(truth && other) && texts[2].includes('≠'));
      each.row.classList.toggle('away', !truth);
      each.row.classList.toggle('wrong', isWrong(each));
      texts.forEach((text, i) => { if (each.cells[i].textContent !== text) each.cells[i].textContent = text; });
    }
    if (!playing) this.arrange();
  }

  // What both runs made of a vessel; this one's first.
  both({ vessel, truth, found }, { truths, detections }) {
    const mine = describe(truth, found)[2], theirs = describe(truths.find((each) => each.vessel === vessel), detections.find((each) => each.vessel === vessel && !each.false))[2];
    const plain = (text) => text.replace(/ [\d.]+/, '');
    return plain(mine) === plain(theirs) ? mine : `${mine} ≠ ${theirs}`;
  }

  // `chosen` is in the close-up, `followed` was asked for.
  mark(chosen, followed) {
    for (const { vessel, row, button } of this.rows) {
      row.classList.toggle('chosen', vessel === chosen);
      row.classList.toggle('followed', vessel === followed);
      button.setAttribute('aria-pressed', vessel === followed);
    }
  }

  // Scroll the list, and not the page, to a vessel.
  reveal(vessel) {
    const { row } = this.rows[vessel], panel = this.body.closest('.vesselRows');
    const { top, bottom } = row.getBoundingClientRect(), seen = panel.getBoundingClientRect();
    if (!row.isConnected || (top >= seen.top + row.offsetHeight && bottom <= seen.bottom)) return;
    panel.scrollTop += top - seen.top - 2 * row.offsetHeight;
  }
}
