"""Chapter 2: scenes, collision, the contact solver and the engine."""
