REGISTRATION_SETTINGS = {
    "annotation.source": "analytic",
    "detector.states.clear.box_error.mean": [0, 0, 0, 0],
    "detector.states.haze.box_error.mean": [0, 0, 0, 0],
}
