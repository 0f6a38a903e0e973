"""Commands for boats in service: `diffsea online`."""
