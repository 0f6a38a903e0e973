"""Commands for boats in service: `diffsea online`, `diffsea metamodel`, `diffsea fleet`."""
