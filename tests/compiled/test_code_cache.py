"""Numba's cache does not outlive a change of any source of the package."""

import os

from deep_contact.compiled.code_cache import drop_stale_code


def test_cached_code_goes_when_any_source_changes(tmp_path):
    cached = tmp_path / "sub" / "__pycache__" / "solver.nbc"
    cached.parent.mkdir(parents=True)
    source = tmp_path / "constants.py"
    source.write_text("SLOP = 1\n")
    drop_stale_code(tmp_path)
    cached.write_bytes(b"machine code")
    assert not drop_stale_code(tmp_path)
    assert cached.exists()
    os.utime(source, ns=(1, 1))
    assert drop_stale_code(tmp_path)
    assert not cached.exists()
