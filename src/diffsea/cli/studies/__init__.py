"""Commands for designing: `diffsea sweep`, `diffsea sensitivity`, `diffsea run`."""
