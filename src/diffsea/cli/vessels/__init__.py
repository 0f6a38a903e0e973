"""Commands on vessel files: made from dimensions, listed, told in words, for other tools."""
