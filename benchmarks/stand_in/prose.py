"""The text of the page docs/stand_in.md that no result changes; what stands in braces is filled in."""

from __future__ import annotations


def filled(text: str, **values: object) -> str:
    """A text as one line, with its values."""
    return " ".join(text.split()).format(**values)


DONE = """
A detector that was trained on photographs looked at {films} films of this program's own scenes, drawn in light and
shade. From {learned} other films a detector file was learned (`modsim3d learn`) and simulated over the same {films}.
{trackers} trackers were scored behind both. The detector found {clear:.0%} of the vessels that were at least half
visible and {hidden:.0%} of the others. {precision:.0%} of its detections were of vessels.
"""
WITHIN = """
The gaps are means over films with their 95 % intervals; a single film may differ by more. A mean gap is the mean size
of the trackers' differences. A group of models is named if it surely shrank that gap where it stands in the ladder; in
another order it might shrink it by more or less. Against the margin of {margin:g}: {verdicts}
"""
LADDER = """
Each rung is a detector file learned from the same films, which may use all models of the rungs before it and one group
more; learning takes those that the data show.
The numbers are HOTA, simulated minus real: the mean over films and its 95 % interval. ✓ agrees: the whole interval lies
within the margin. ✗ differs: all of it lies outside. ? these films do not say.
"""
SCORES_BEGIN = """
First the real score, then simulated minus real. [Scores](scores.md) says what each means.
"""
HOLD = """
These means over films hold on simulated detections. In brackets stand the real value and the margin. Where the margin
is about as large as the value, this says little:
"""
HOLD_NOT = "These do not hold. Simulation gives another value:"
OPEN = """
Of these the films do not say whether they hold. In brackets stands about how many films would show that they do if the
mean stayed, or that the mean lies outside the margin, and whether the difference is surely not 0:
"""
BESIDE = "Beside the scores:"
USE = """
A score that holds may stand for the real one in an argument about the mean over films like these: this detector, these
trackers and these three places, drawn and not filmed. It says nothing of a single film. Where the films do not say,
agreement is not shown, and the value must not be used as if it were.
"""
ORDER = """
By HOTA. The orders are those of the means over films, the best first. Kendall's tau is 1 where all pairs of trackers
stand in the same order within a film, and −1 where all are reversed. *Among seeds* is the tau of one simulated output
against another, which is to be expected if the real output were one like the simulated ones. The last two columns are
shares of 4,000 draws of films, with replacement, in which the whole order, and the best tracker, are the same on real
and simulated detections. Trackers whose real means lie close together change places in many draws on either side.
"""
SCATTER = """
How much HOTA, simulated minus real, scatters from film to film, over how much it would if the real output were one like
the simulated seeds. At 1 the seeds of a simulation span what the detector does on a film. Above 1 films differ by
something that the detector file does not have, and the spread over seeds says too little about a single film; in bold
where an F-test finds it at the 5 % level, each cell by itself: of twenty cells without a cause one would be bold.
"""
DISTRIBUTIONS = """
At the last rung. *Distance* is the largest one between the two distribution functions (Kolmogorov and Smirnov). *To
move* is how far values must be moved on average to make one distribution of the other. The p-value is the share of
exchanges of real and simulated outputs within films that have at least this distance, adjusted for the number of lines
by Holm's method. Below 0.05, in bold, the two differ. Above it no difference was found, which is no proof that there is
none.
"""
BINS_BEGIN = """
At the last rung: the share of vessel-frames that a track follows, simulated minus real. A part has fewer vessel-frames
than the whole, so the margin is {margin:g}.
"""
GROUPS = """
HOTA of groups of films, simulated minus real, with the margin {margin:g}. Where groups differ to either side, the mean
over all films is nearer to 0 than each of them. Films with *much* occlusion have more than
{share:.1%} of vessel-frames with less than half of the vessel visible.
"""
JUDGED = """
Limits, films, seeds and when to stop (at the last film, scored once) were fixed before the first film was made, and no
model was changed after that. These {films} films are the second set: the models were settled on {learned} other films,
from which the detector files are learned. A change of the models after this needs a third set.
"""
DEVELOPED = """
The models were settled in sight of these {films} films; the detector files are learned from {learned} others. So this
says what the models can do, and not yet how they do on films that nobody has seen.
"""
GOALS = """
A goal is reached if the whole 95 % interval lies within its limit, and missed if all of it lies outside. Correlations
have no interval.
"""
EXCHANGED = """
At the last rung and its first seed, one part of a detector's output was taken from the other one: HOTA, AssA and ID
switches, minus those behind real detections. Where the part of a vessel is not known because it was missed, it is that
of the nearest frame. The first line says what taking detections apart and putting them together changes by itself. The
part whose exchange brings simulated scores to real ones, or takes real ones to simulated ones, is where the gap comes
from.
"""
PAIRS = """
Trackers that are surely apart on real detections, by 95 % intervals of their paired difference in HOTA over films, and
how far they are apart on simulated ones:
"""
CLASSIFIER = """
The area under the ROC curve of a gradient-boosted classifier that is shown frames, or tracks of vessels, of films that
it was not trained on, with its 95 % interval over films. 0.5 is guessing, 1 is certainty. There is no goal: it sees
textures, above all of box errors, that trackers do not feel. *Told by* names the features that reach most alone,
with their area.
"""
SEEDS_APART = "check: one seed of the last rung against its others"
MISSING = (
    """Of two vessels that overlap by a tenth or more, the real detector is sure of one at most: both had a confidence
    of 0.6 or more in 12 of 3,765 pairs in 21 films, in simulation in 68 of 3,801. Simulated scores of two vessels know
    nothing of each other.""",
    """Boxes around two vessels take those that it is unsure of: of two found vessels, the surer one with a confidence
    of 0.2 to 0.4, 22 % were one box in the next frame, from 0.8 on 2 %; in simulation 5 % and 3 %.""",
    """Most boxes fit to a pixel or two, and some are far off for seconds, such as those that reach down into a
    reflection in calm water. Student's t, at the least degrees of freedom that are fitted, is a rough model of it.
    Simulated box errors in the place of real ones raised HOTA by 0.004 to 0.010 on the films that models were settled
    on, and AssA by at most 0.010.""",
)
"""What was seen in the real detections and is not simulated, the largest first."""
LIMITS = (
    "Rendered pictures are no sea. The detector is real; what it looks at is not. It errs otherwise on photographs.",
    "It is one detector. Another one may need models that this one does not.",
    """The films are short: {frames} frames each. Rare events, such as long occlusions, have little weight, and each
    film begins without tracks.""",
    """Scores depend on how tracks are matched with vessels: here by an intersection over union of at least {least:g}
    with the boxes of what is visible. HOTA takes the mean over many thresholds, the others have this one.""",
    """The trackers have the settings that were chosen for the shipped scenes, behind other detectors. They are the same
    for real and simulated detections, but not the best for this detector.""",
    """The films are of three places. The intervals are over traffic, waves and weather in these places, not over
    places.""",
    """The films were drawn before the sea had moving waves, glitter and softer reflections, and the sky clouds.
    Nothing on this page is of that sea.""",
    """Films in which a score is undefined, as the length of tracks without a track, do not count for it. Margins that
    are shares of a real mean take that mean as known.""",
    """The detector file is learned once. The intervals are over films, and leave out what learning from other films
    would have changed.""",
    "Each interval has 95 % by itself. Of many intervals, a few miss the truth.",
)
METHOD = """
`script/campaign stand_in` writes this page, and `campaigns/stand_in.json` with all its figures. There are {films} films
that no learning saw, {seeds} seeds of the simulated detector on each, and detections of a confidence of at least
{threshold:g}. A film gives one difference: the mean over seeds minus the real score. The interval is Student's t over
films. {split}
"""
SPLIT = """
For HOTA of `{tracker}`, the standard deviation is {within:.3f} from seed to seed of a film and {between:.3f} from film
to film beside that.
"""
MARGINS = "Margins were fixed before any film was scored:"
TESTS = """
Agreement is two one-sided tests at 2.5 % each, which is to say that the whole 95 % interval lies within the margin.
A group of models surely changes the mean gap if it does so in 97.5 % of 2,000 draws of films, with replacement.
"""
