"""The contract of the figure scripts, results files and plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.io.lazy import attach

if TYPE_CHECKING:
    from deep_contact.reporting.figures import Figure as Figure
    from deep_contact.reporting.results import Claim as Claim

__getattr__, __dir__, __all__ = attach(__name__, __file__)
