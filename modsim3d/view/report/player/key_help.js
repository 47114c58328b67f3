// The list of keys, in a dialog: made of the same table that the keys obey.

class KeyHelp {
  constructor(groups) {
    const part = ({ title, keys }) => element('section', {}, element('h3', { textContent: title }), element('dl', {},
      ...keys.map(({ shown, words }) => element('div', {},
        element('dt', {}, ...shown.split(' ').flatMap((key) => [element('kbd', { textContent: key }), ' '])), element('dd', { textContent: words })))));
    const close = element('button', { type: 'button', textContent: 'Close', title: 'Close (Escape)', autofocus: true });
    this.dialog = element('dialog', { id: 'keys' }, element('div', { className: 'title' }, element('h2', { id: 'keysTitle', textContent: 'Keys' }), close),
      element('div', { className: 'keyGroups' }, ...groups.map(part)));
    this.dialog.setAttribute('aria-labelledby', 'keysTitle');
    close.addEventListener('click', () => this.dialog.close());
    this.dialog.addEventListener('click', ({ target }) => { if (target === this.dialog) this.dialog.close(); }); // beside it
    document.body.append(this.dialog);
  }

  // A modal dialog keeps the focus in it and closes at Escape; then the focus is where it was.
  toggle() {
    if (this.dialog.open) this.dialog.close();
    else this.dialog.showModal();
  }
}
