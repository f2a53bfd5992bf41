"""Chapter 2: scenes, collision, the contact solver and the engine."""

from deep_contact.compiled import prepare_numba

prepare_numba()
