"""What has no transponder: false detections that behave like vessels, told from those that flicker."""
