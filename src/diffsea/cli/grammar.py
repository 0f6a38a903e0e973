"""How words on the command line are understood: near misses are answered by what was meant."""

import argparse
import difflib
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn


GREETING = """\
diffsea tells what your boat does, and what your model of it leaves out.

  diffsea check LOG                          what is in a log, whether it is sound, what it shows
  diffsea new boat.toml --length 1.4 --beam 0.93 --mass 22 --thrusters 0.66
                                             a vessel file from what you know of the boat
  diffsea diagnose boat.toml LOG             what the model leaves out

Without a log: diffsea trial otter --manoeuvre zigzag
All commands: diffsea --help; one of them: diffsea COMMAND --help
"""


class Parser(argparse.ArgumentParser):
    """A parser that asks "did you mean" of a command or an option that there is not.

    An unknown option is told before anything that is missing: where `--manoeuvre` is misspelled,
    it is not called absent. Options are not abbreviated, so that a new one changes no script.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **{"allow_abbrev": False, **kwargs})

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As argparse does, once every word is known to be one."""
        words = _with_negative_lists(sys.argv[1:] if args is None else args)
        commands = self._commands()
        if commands:
            first = next((word for word in words if not word.startswith("-")), None)
            if first is not None and first not in commands:
                self._refuse("command", first, commands)
            words_here = words[: words.index(first)] if first else words
        else:
            words_here = words[: words.index("--")] if "--" in words else words
        for word in words_here:
            name = word.partition("=")[0]
            if word.startswith("--") and name not in self._option_string_actions:
                self._refuse("option", name, self._option_string_actions)
        return super().parse_known_args(words, namespace)

    def _commands(self) -> Sequence[str]:
        """The names of sub-commands, none where this parser is one."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                return tuple(action.choices)
        return ()

    def _refuse(self, what: str, word: str, known: Iterable[str]) -> NoReturn:
        """End with bad usage, with the nearest of what is known."""
        near = difflib.get_close_matches(word, [name for name in known if len(name) > 2], n=1)
        meant = f"did you mean {near[0]!r}?" if near else f"{self.prog} --help lists them"
        self.error(f"there is no {what} {word!r}; {meant}")


def _with_negative_lists(words: Sequence[str]) -> list[str]:
    """Words with `--option -1,2` as `--option=-1,2`: argparse takes the list for an option."""
    joined: list[str] = []
    for word in words:
        is_value = bool(joined) and joined[-1].startswith("--") and "=" not in joined[-1]
        if is_value and re.fullmatch(r"-[\d.]+(,-?[\d.]+)+", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


class GivenOnce(argparse.Action):
    """An option whose values all stand after one flag: a second one is bad usage."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        if getattr(namespace, self.dest) is not None:
            flag = self.option_strings[0]
            raise argparse.ArgumentError(self, f"give all values after one {flag}: {flag} A B ...")
        setattr(namespace, self.dest, values)
