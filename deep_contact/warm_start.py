"""Starting impulses of the solver. Every start is a callable `start(state, solver) -> (normal, tangent)`.

state: a `State` with m contacts. solver: options of the solver, such as `PGS()`. Returned: the normal and the tangent
impulses from which the solver starts, (m,) each, N·s. A run takes a start by its name, or any such callable. It raises
an error if the returned arrays do not fit the contacts; it never replaces them by zeros.

Tests: tests/starts/test_starts.py
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.lazy import attach

if TYPE_CHECKING:
    from deep_contact.cnn.start import Cnn as Cnn
    from deep_contact.cnn.start import FarFieldNoPast as FarFieldNoPast
    from deep_contact.sph.start import TRANSFERS as TRANSFERS
    from deep_contact.sph.start import Copy as Copy
    from deep_contact.sph.start import Sph as Sph
    from deep_contact.sph.start import Transfer as Transfer
    from deep_contact.sph.start import solved_impulses as solved_impulses
    from deep_contact.starts.classical import Builtin as Builtin
    from deep_contact.starts.classical import FromProblem as FromProblem
    from deep_contact.starts.classical import NoStart as NoStart
    from deep_contact.starts.classical import Scaled as Scaled
    from deep_contact.starts.classical import Support as Support
    from deep_contact.starts.classical import starting_impulses as starting_impulses
    from deep_contact.starts.names import STARTS as STARTS
    from deep_contact.starts.names import Classical as Classical
    from deep_contact.starts.names import Name as Name
    from deep_contact.starts.names import Start as Start
    from deep_contact.starts.names import WarmStart as WarmStart
    from deep_contact.starts.names import warm_start_of as warm_start_of

__getattr__, __dir__, __all__ = attach(__name__, __file__)
