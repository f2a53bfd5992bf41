"""Where the solver starts. Every start has one signature: `start(state, solver) -> (normal, tangent)`.

state: a `State` with contacts. solver: the options it will be solved with. Returned: the impulses to start from, (m,)
each, N·s. The engine knows a start by its name or takes any such callable; it raises where the result does not fit
the contacts, and nothing falls back to zero.
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
