"""Learning from a voyage without labels: AIS and the scene are the truth to register cameras and clocks against."""
