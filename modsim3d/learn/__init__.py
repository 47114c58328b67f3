"""From what a detector put out to its statistics: does a run obey its detector file?"""
