"""Chapter 2: scenes, collision, the contact solver and the engine."""

from deep_contact.compiled.code_cache import drop_unfit_code

drop_unfit_code()
