"""Spellings under which a word list may hold a label: joined, singular, lemma, alias."""

from collections.abc import Iterator, Mapping

SPELLINGS = {
    "colour": "color",
    "grey": "gray",
    "aluminium": "aluminum",
    "centre": "center",
    "fibre": "fiber",
    "jewellery": "jewelry",
    "mould": "mold",
    "tyre": "tire",
}
"""British and American spellings of the same word, tried in both directions."""

_BOTH = {**SPELLINGS, **{american: british for british, american in SPELLINGS.items()}}
_VOWELS = "aeiou"


def joined_forms(label: str) -> list[str]:
    """Return the spellings of a label of several words as one word."""
    words = label.split()
    return [glue.join(words) for glue in ("-", "_", "", " ")] if len(words) > 1 else []


def word_forms(word: str) -> list[str]:
    """Return other forms of a word, nearest first: spelling, singular, lemma."""
    forms = [_BOTH[word]] if word in _BOTH else []
    forms += list(_singular(word))
    forms += list(_lemma(word))
    return list(dict.fromkeys(form for form in forms if len(form) > 1 and form != word))


def all_forms(label: str, aliases: Mapping[str, str]) -> set[str]:
    """Return every spelling that the lookup of a label may try."""
    forms = {label, *joined_forms(label)}
    for word in label.split():
        forms |= {word, *word_forms(word)}
    for key in (label, *label.split()):
        if key in aliases:
            alias = aliases[key].lower()
            forms |= {alias, *alias.split(), *joined_forms(alias)}
    return forms


def _singular(word: str) -> Iterator[str]:
    if word.endswith("'s"):
        yield word[:-2]
    if word.endswith("ies"):
        yield word[:-3] + "y"
    if word.endswith(("ses", "xes", "zes", "ches", "shes", "oes")):
        yield word[:-2]
    if word.endswith("ves"):
        yield word[:-3] + "f"
        yield word[:-3] + "fe"
    if word.endswith("s") and not word.endswith("ss"):
        yield word[:-1]


def _lemma(word: str) -> Iterator[str]:
    for ending in ("ing", "ed", "er", "est", "ly"):
        stem = word.removesuffix(ending)
        if stem == word or len(stem) < 3:
            continue
        yield stem
        yield stem + "e"
        if stem[-1] == stem[-2] and stem[-1] not in _VOWELS:
            yield stem[:-1]
        if stem.endswith("i"):
            yield stem[:-1] + "y"
