"""What a setting costs on a scene, and what it gets wrong: runs beside a reference, and beside other engines."""
