"""How accurate, and the cheapest way there: `recommend`, and the presets of `simulate(accuracy=…)`."""

from deep_contact.recommendation.runs import PRESETS, Recommendation, recommend

__all__ = ["PRESETS", "Recommendation", "recommend"]
