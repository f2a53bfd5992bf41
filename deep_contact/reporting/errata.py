"""Faults of the thesis as it is printed, and what this package does: one table, for the report and for the README.

`python -m deep_contact.reporting.errata` prints it as Markdown.
"""

from __future__ import annotations

from typing import NamedTuple


class Erratum(NamedTuple):
    """One fault.

    | field  | meaning                                                     |
    |--------|-------------------------------------------------------------|
    | where  | equation, algorithm, section or line of the thesis          |
    | thesis | what it says                                                |
    | right  | what is right                                               |
    | here   | what this package does, and where that is shown             |
    """

    where: str
    thesis: str
    right: str
    here: str


ERRATA = (
    Erratum(
        "Eq 2.27",
        "A = J M⁻¹ Jᵀ Δt, for contact forces",
        "what the engine and the files hold are impulses: A = J M⁻¹ Jᵀ, b = J (v + Δt M⁻¹ F)",
        "impulses throughout, in N·s",
    ),
    Erratum(
        "Algorithm 1",
        "rows of the normal impulses only",
        "a friction row for each contact, clamped by the normal impulse of the moment and swept before it",
        "the coupled sweep; the linear complementarity form of the algorithm is a function of its own",
    ),
    Erratum(
        "convergence log of the original code",
        "the larger of normal and tangent change without absolute values; steps that have ended leave the average",
        "θ is the largest absolute change of any row (Eq 2.30)",
        "two-sided θ; a step that has ended goes on counting with its last value",
    ),
    Erratum(
        "Eq 3.8 and 3.11",
        "315 / (64πh⁹) and 15 / (πh⁶) on a plane",
        "these are constants in space; on a plane poly6 has 4 / (πh⁸), spiky 10 / (πh⁵)",
        "dim=2 by default, dim=3 for the thesis's numbers (Figures 3.3 and 3.4)",
    ),
    Erratum(
        "Eq 3.10",
        "Laplacian of poly6 with −945 / (16πh⁹)",
        "−945 / (32πh⁹) (h² − r²)(3h² − 7r²) in space, 48 / (πh⁸) (h² − r²)(3r² − h²) on a plane",
        "the right form, held against finite differences",
    ),
    Erratum(
        "Eq 3.13",
        "Laplacian of spiky 90 / (πh⁶) (h − r): the second derivative alone",
        "−90 / (πh⁶) (h − r)(h − 2r) / r in space, 30 / (πh⁵) (h − r)(3r − h) / r on a plane",
        "the right form, held against finite differences",
    ),
    Erratum(
        "Algorithm 4",
        "the 2 × 2 matrix of the nodes' values transposed",
        "the matrix of Eq 3.16",
        "the right form; Figure 3.5 shows the difference on a field without symmetry",
    ),
    Erratum(
        "Appendix A",
        "both kernels divided by the sum of their weights, which hides any constant",
        "a kernel's value and its normalisation are two things",
        "kernels return W; how it is normalised is an argument of the transfer",
    ),
    Erratum(
        "L669",
        "Builtin converges much as starting from zero does",
        "only while the circles fall; in a settled pile it is far ahead",
        "both are measured, over the same states and over runs of their own (Figure 3.7)",
    ),
    Erratum(
        "L1341",
        "a limit of the SPH-based method",
        "a fault of the transfer: an isolated contact comes back with a quarter to all of its impulse",
        "the thesis's transfer as it is, and a consistent one that divides by the density (Figure 6.3)",
    ),
    Erratum(
        "Eq 4.2",
        "(I − K) / s + 1 for every stride",
        'rounded down where s does not divide I − K; with the border mode "same" of Table 5.2, I / s rounded up',
        "Figure 4.2",
    ),
    Erratum(
        "Eq 4.6",
        "L2 regularisation adds the sum of the weights",
        "a factor times the sum of their squares",
        "Keras's L2 regulariser",
    ),
    Erratum(
        "L829",
        "gradients hardly vanish or explode with ReLU",
        "only with weights of the right size, such as He's",
        "Figure 4.4",
    ),
    Erratum(
        "L991",
        "Eq 4.13 from Eq 4.11 and 4.15",
        "from Eq 4.11 and 4.12",
        "Figure 4.7",
    ),
    Erratum(
        "Eq 4.14",
        "w_j + α v_j e_j",
        "w_j + 2 α v_j e_l: the factor 2 of Eq 4.13 is lost and the index is another",
        "Figure 4.7, against automatic differentiation",
    ),
    Erratum(
        "L1002",
        "hidden weights are updated after those of the output, by Eq 4.18",
        "the w_j of Eq 4.18 are those from before their own update",
        "Figure 4.7",
    ),
    Erratum(
        "section 5.2.3, Tables 5.1 and 5.2",
        "4, 5 or 6 input channels",
        "[m, v_x, v_y, ω] are 4; with n_x 5, which the number of parameters needs",
        "5 for the thesis's network",
    ),
    Erratum(
        "section 5.3.1",
        "64,498,866 parameters in one place, 51,599,092 in another",
        "64,498,866 are the trainable ones of the network of Table 5.1 and Appendix B",
        "that network exactly",
    ),
    Erratum(
        "Table 5.1",
        "4 × 4 × 512 after the fourth batch normalisation",
        "4 × 4 × 256: normalisation does not change the number of maps",
        "the table of the network as it is built",
    ),
    Erratum(
        "grid of the images",
        "61 nodes along an edge in some places, 41 in others",
        "30 m / 0.5 m + 1 = 61; 41 belongs to d = 0.75 m",
        "61",
    ),
    Erratum(
        "last layer of the network",
        "ReLU",
        "tangent impulses have both signs, so half of them cannot be predicted",
        "kept in the thesis's network; ours is linear",
    ),
    Erratum(
        "Algorithm 6",
        "learning rates by epoch 100, then 300 undefined, last branch above 300; Appendix B has other rates",
        "last branch above 500",
        "both schedules, by name",
    ),
    Erratum(
        "dropout",
        "0.1 after every stack (Tables 5.1, 5.2), or one layer (Appendix B)",
        "no number depends on it: dropout has no parameters",
        "0.1 after every stack",
    ),
    Erratum(
        "XML import of the original code",
        "reads other names than the export writes, and evaluates text of the file as code",
        "one format, read as it is written, as data",
        "the round trip is exact; nothing in a file is ever evaluated",
    ),
)
"""In the order of the thesis's chapters."""

HEAD = ("Where", "Thesis", "Right", "Here")


def markdown() -> str:
    """The table as Markdown."""
    rows = [HEAD, ("---",) * len(HEAD), *ERRATA]
    return "\n".join("| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in rows) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
