"""`Parser`: an argument parser that suggests the nearest option or command for a misspelt one.

Tests: tests/test_command_line.py
"""

from __future__ import annotations

import argparse
import difflib
import re


class Parser(argparse.ArgumentParser):
    """An `argparse.ArgumentParser`. Its errors for an unknown option or command suggest the most similar known one."""

    def parse_known_args(self, args=None, namespace=None):
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown and self._subparsers is None:  # here, so that the error names the command and knows its options
            options = [word for action in self._actions for word in action.option_strings]
            wrong = [word.partition("=")[0] for word in unknown if word.startswith("-")]
            self.error(f"unrecognized arguments: {' '.join(unknown)}{_near(wrong[0], options) if wrong else ''}")
        return parsed, unknown

    def error(self, message):
        choice = re.search(r"invalid choice: '([^']+)' \(choose from (.*)\)$", message)
        super().error(message + (_near(choice[1], re.findall(r"[\w-]+", choice[2])) if choice else ""))


def _near(word: str, known: list[str]) -> str:
    """Return a suggestion of the known word that is most similar to `word`, "" if none is similar."""
    return "".join(f"; did you mean {name}?" for name in difflib.get_close_matches(word, known, 1))
