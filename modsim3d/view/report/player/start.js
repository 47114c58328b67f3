try {
  const recording = await openRecording();
  $('board').hidden = false;
  window.player = new Player(recording); // for the console, and for tests
} catch (error) {
  $('failure').hidden = false;
  $('failure').textContent = `The player cannot start: ${error.message}`;
  throw error;
}
