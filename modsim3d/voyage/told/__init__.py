"""What is reported of a voyage: its registration, what AIS does not see, and the sea that it covers."""
