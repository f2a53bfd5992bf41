"""Runs: of one scene, of many, and live."""
