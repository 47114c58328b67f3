function showFailure(error) {
  $('failure').hidden = false;
  $('failure').textContent = `The player cannot go on: ${error.message}`;
}

try {
  const recording = await openRecording('A');
  $('board').hidden = false;
  const player = new Player(recording);
  await player.waiting;
  performance.mark('first frame');
  window.player = player; // for the console, and for tests
} catch (error) {
  showFailure(error);
  throw error;
}
