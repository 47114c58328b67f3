function showFailure(error) {
  $('failure').hidden = false;
  $('failure').textContent = `The player cannot go on: ${error.message}`;
}

try {
  const differences = await openDifferences();
  const recordings = await Promise.all((differences ? LETTERS : ['A']).map(openRecording));
  $('board').hidden = false;
  const player = new Player(recordings, differences);
  await player.waiting;
  performance.mark('first frame');
  window.player = player; // for the console, and for tests
} catch (error) {
  showFailure(error);
  throw error;
}
