"""Runs of one scene, runs of many scenes, and live runs that can be changed between steps."""
