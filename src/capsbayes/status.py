"""Reasons for the end of a piece of work, each a sentence for people."""

from __future__ import annotations

import enum


class Status(enum.Enum):
    """End of a solve, of a chain or of a measurement.

    The member's value is the sentence shown to people; its name is what is stored in files.
    """

    DONE = "Done."
    # steady states
    NO_STEADY_STATE = (
        "No steady state was found: the capillary number lies above the limit of existence at this size ratio."
    )
    NOT_CONVERGED = "The Newton iteration did not converge; start from a nearer steady state or refine the mesh."
    UNSTABLE = "The steady state that was followed is unstable, or may be: start from rest to see where a capsule goes."
    UNRESOLVED = "The mesh does not resolve the rear rim (slack above its limit); refine the mesh."
    RAISED = "The computation broke off with an error; run this case alone to see it."
    NOT_TRIED = "Not tried, because the cases it would have started from did not converge."
    # pictures
    BACKGROUND_DIFFERS = "The picture of the empty channel has another size than that of the capsule."
    NO_WALLS = (
        "No two parallel walls were found across the picture, as they may be bent, open or too rough, "
        "or several channels; cut it around one (--crop), say where the walls are (--walls), "
        "or give the size of a pixel (--pixel-size) and the axis (--axis)."
    )
    WALLS_OFF = (
        "The walls are stated off the dark lines of the picture, so that l is wrong by more than five times its error: "
        "state them on the lines (--walls), or their error (--wall-error)."
    )
    UPRIGHT = (
        "The walls run up and down the picture, but the flow must run along its rows: turn the picture by a quarter "
        "(--rotate 90)."
    )
    SATURATED = "The picture is clipped between the walls; expose it less."
    BLACK = (
        "The picture is black between the walls, at the lower end of the camera's scale: expose it longer, and give it "
        "as it was recorded, not after a subtraction."
    )
    NO_CAPSULE = "No capsule was found between the walls."
    SEVERAL_CAPSULES = "Several capsules were found between the walls; cut the picture around one of them (--crop)."
    DEBRIS = "The object found is too small for a capsule."
    DOUBLET = "The outline is notched: two capsules touch or overlap, or something sticks to one (erase it: --erase)."
    INTERLACED = (
        "The odd rows of the frame show another moment than the even ones (interlaced video); deinterlace the film, or "
        "film without."
    )
    LOPSIDED = "The outline is not symmetric about the flow: two objects overlap, or one lies askew."
    OVERLAP = "A second nose is seen inside the capsule, or it is as dark around it: two capsules overlap."
    SMEARED = "The capsule moved by more than three pixels during the exposure; expose it for a shorter time."
    SHADED = (
        "Something dark that is no capsule lies along a wall or runs from the border, as a shadow or a faulty row of "
        "the camera; give a picture of the empty channel that shows it too, or crop it off (--crop)."
    )
    DEAD_COLUMN = "An end of the capsule lies on a dead column of the camera; take a picture of it elsewhere."
    BROKEN_MASK = "The mask of the event falls into several pieces."
    TOO_CLOSE = "Something else lies so close to the capsule that its edge could not be located."
    TOUCHES_BORDER = "The capsule touches the border of the picture."
    NO_EDGE = "The edge of the capsule could not be located all around; it is too blurred or too faint."
    WRONG_FLOW = (
        "The shape of the capsule shows a flow in another direction than given, or than its frames do in their order."
    )
    FEW_FRAMES = (
        "The capsule was seen whole, or could be followed along the flow, in fewer than three frames, too few for a "
        "velocity and its error."
    )
    UNSTEADY = "The capsule still changes along the channel; film it further downstream."
    COVERED = (
        "The film does not show the empty channel: capsules cover a place in all but a few frames, as they do if they "
        "move by less than their own length, or something dark lies still; film longer, or give a background."
    )
    TAKE_TURNS = (
        "Two kinds of frames take turns, as those of two channels or exposures; split the film, and measure one kind, "
        "with the frame rate that it then has."
    )
    REPEATED = (
        "Many frames show the capsule where the one before did, as copies do: keep one of each, and give the frame "
        "rate that the film then has."
    )
    # posteriors
    NOT_MIXED = "The chains did not pass their convergence gates within the budget; do not use the intervals."
    LEANS_ON_BORDER = "The posterior leans on the border of the database: its intervals are cut there, not measured."
    LEANS_ON_PRIOR = "The posterior leans on a range of its prior: widen the range, or read the intervals as cut there."
    LEANS_ON_TWO_SHAPES = (
        "The posterior leans on low capillary numbers at which two steady shapes are stable: "
        "its intervals hold for a capsule that was started from rest."
    )
    LEANS_ON_WRINKLES = (
        "The posterior leans on capsules whose membrane wrinkles about the axis; the model's shape is smooth, and its "
        "length on the axis some 2 % too short."
    )
    LEANS_ON_UNSURE_SHAPES = (
        "The posterior leans on shapes whose lengths the model knows to no better than 5 %, since its simulations lie "
        "too far apart there; its intervals contain that error."
    )
    GRID_TOO_COARSE = "The grid did not resolve the posterior within its largest size; do not use the intervals."
    SHAPES_MISFIT = (
        "No membrane of the model gives all capsules their shapes: together they differ by more than their stated "
        "errors; check the errors, or diagnose what is missing, and do not use the intervals."
    )
    TOO_FEW_DRAWS = (
        "Too few draws of the importance sampling are effective, or a few of them weigh too much; do not use the "
        "intervals."
    )
    NO_SHAPE = "No shape of the model is near the lengths: they are more than five standard errors from every one."
    OUTLINE_MISFIT = (
        "The outline fits no shape of the model: even the best one is off by more than twice the stated errors; "
        "do not use the intervals."
    )
    LENGTHS_MISFIT = (
        "The lengths contradict the priors: no shape that the priors allow has these lengths at this velocity; check "
        "the priors and the units, and do not use the intervals."
    )
    FLOW_CONFLICT = (
        "The flow rate over the area of the cross-section and the velocity of the capsule contradict each other: check "
        "both, their units, and that the half width is half of the full width; do not use the intervals."
    )
    INERTIA = (
        "The Reynolds number is above one, where inertia is no longer small, and the model has none: slow the flow, or "
        "use the intervals with care."
    )
    UNUSABLE = "The numbers given for this capsule cannot be used; see its reason."
    NOT_RESIMULATED = (
        "The simulator found too few of the shapes of the posterior, or its correction leads to where it found none; "
        "do not use the intervals."
    )
    ENGINES_DISAGREE = "Sampling and quadrature disagree beyond their tolerance; do not use the intervals."
    # studies of sensitivity
    NO_FLOW_RATE = "No flow rate keeps the expected capsules below the limit of existence with the margin asked for."
    RANGES_LEAVE_DATABASE = (
        "More than a tenth of the samples have a shape that no capsule of the database has: narrow the ranges."
    )

    @property
    def ok(self) -> bool:
        """True when the work ended as it should."""
        return self is Status.DONE

    def __str__(self) -> str:
        return self.value
