"""The common part of the figure and table scripts: settings, results files, claims and pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.lazy import attach

if TYPE_CHECKING:
    from deep_contact.figures.figure import INTERRUPTED as INTERRUPTED
    from deep_contact.figures.figure import MEANINGS as MEANINGS
    from deep_contact.figures.figure import Figure as Figure
    from deep_contact.figures.figure import assigned as assigned
    from deep_contact.figures.figure import cell as cell
    from deep_contact.figures.figure import claim_line as claim_line
    from deep_contact.figures.figure import common_arguments as common_arguments
    from deep_contact.figures.figure import main as main
    from deep_contact.figures.figure import meaning as meaning
    from deep_contact.figures.figure import produce as produce
    from deep_contact.figures.figure import run_as_script as run_as_script
    from deep_contact.figures.results import Claim as Claim
    from deep_contact.parallel import cores as cores
    from deep_contact.parallel import parallel_map as parallel_map
    from deep_contact.parallel import progress_bar as progress_bar
    from deep_contact.parallel import seeds as seeds

__getattr__, __dir__, __all__ = attach(__name__, __file__)
