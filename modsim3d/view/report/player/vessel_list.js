// The list of vessels: what became of each in the frame.

class VesselList {
  constructor(body, facts, choose) {
    this.facts = facts;
    this.rows = facts.vessels.map(({ name }, vessel) => {
      const button = element('button', { type: 'button', title: name }, swatchOf(facts.colours.vessels[vessel]), name);
      button.addEventListener('click', () => choose(vessel));
      const cells = ['', '', ''].map(() => element('td'));
      const row = element('tr', {}, element('td', {}, button), ...cells);
      body.append(row);
      return { row, button, cells };
    });
  }

  show(frame, carrier) {
    const { vessels } = this.facts, truths = new Map(frame.truths.map((truth) => [truth.vessel, truth]));
    const detections = new Map(frame.detections.filter((each) => !each.false).map((each) => [each.vessel, each]));
    this.rows.forEach(({ row, cells }, vessel) => {
      const truth = truths.get(vessel), found = detections.get(vessel);
      const away = vessels[vessel].name === carrier ? 'carries the camera' : 'not in the image';
      const texts = truth ? describe(truth, found) : ['', '', away];
      row.classList.toggle('away', !truth);
      row.classList.toggle('wrong', Boolean(truth?.missed || found?.mislabelled || found?.bad));
      texts.forEach((text, i) => { if (cells[i].textContent !== text) cells[i].textContent = text; });
    });
  }

  // `chosen` is in the close-up, `followed` was asked for.
  mark(chosen, followed) {
    this.rows.forEach(({ row, button }, vessel) => {
      row.classList.toggle('chosen', vessel === chosen);
      button.setAttribute('aria-pressed', vessel === followed);
    });
  }
}
