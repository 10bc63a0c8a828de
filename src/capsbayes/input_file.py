"""A TOML file read with every key checked: one clear line where it is wrong."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from capsbayes.errors import InputError

__all__ = ["InputFile"]


@dataclass(frozen=True, eq=False)
class InputFile:
    """Content of a TOML file.

    Parameters
    ----------
    path : Path
        Where it was read.
    content : mapping
        Keys and tables.
    sha256 : str
        Fingerprint of its bytes.
    """

    path: Path
    content: Mapping[str, Any]
    sha256: str

    @classmethod
    def read(cls, path: str | Path) -> InputFile:
        """Read a file.

        Raises
        ------
        InputError
            If it is missing, unreadable or not TOML.
        """
        path = Path(path)
        try:
            raw = path.read_bytes()
            content = tomllib.loads(raw.decode())
        except FileNotFoundError:
            raise InputError(str(path), "", "a file", "nothing there") from None
        except OSError as error:
            raise InputError(str(path), "", "a readable file", str(error.strerror)) from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(str(path), "", "a TOML file", str(error)) from None
        return cls(path, content, hashlib.sha256(raw).hexdigest())

    def table(
        self,
        name: str = "",
        *,
        required: Collection[str] = (),
        optional: Collection[str] = (),
        renamed: Mapping[str, str] = MappingProxyType({}),
    ) -> dict[str, Any]:
        """Return one table after checking its keys.

        Parameters
        ----------
        name : str
            Table, or empty for the keys at the top of the file. A missing
            table is an empty one.
        required, optional : collection of str
            Keys it must and may have.
        renamed : mapping of str to str
            Present names of keys that older files have, by their names there.

        Returns
        -------
        dict

        Raises
        ------
        InputError
            On an unknown or a missing key.
        """
        table = self.content.get(name, {}) if name else self.content
        if not isinstance(table, Mapping):
            raise InputError(str(self.path), name, f"a table [{name}]", repr(table))
        table = {key if renamed.get(key, key) in table else renamed.get(key, key): table[key] for key in table}
        known = [*required, *optional]
        for key in table:
            if key not in known:
                raise InputError(str(self.path), _dotted(name, key), f"one of {', '.join(known)}", "an unknown key")
        for key in required:
            if key not in table:
                raise InputError(str(self.path), _dotted(name, key), "a value", "nothing", "add the missing key")
        return dict(table)


def _dotted(table: str, key: str) -> str:
    return f"{table}.{key}" if table else key
