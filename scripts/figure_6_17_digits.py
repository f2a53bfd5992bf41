"""python scripts/figure_6_17_digits.py: convergence from solutions rounded to some significant digits.

The other starts are Builtin, the impulses of the step before, and Copy, the solution itself.
"""

from deep_contact import figures
from deep_contact.studies import starts, verdicts

DIGITS = (1, 2, 3, 4)


def named(digits):
    return f"Copy, {digits} digit{'s' * (digits > 1)}"


STARTS = {"builtin": "builtin", **{named(digits): {"digits": digits} for digits in DIGITS}, "copy": "copy"}


def claims(data):
    for digits in DIGITS:
        faster = f"the solution rounded to {digits} significant digit{'s' * (digits > 1)} converges faster than Builtin"
        yield verdicts.judged(data, named(digits), "builtin", faster)


FIGURE = starts.convergence_figure(
    id="6.17", title="How exact must a start be?", starts=STARTS, claims=claims, over=None, seed=617,
)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
