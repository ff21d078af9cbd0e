"""Build the shipped table of synonyms and derived words, `wordnet-synonyms.txt.xz`.

Each line is a kind and words of which any may stand for any other: synonyms (n, v, a) that share
one of the first senses of both, words derived from each other (d), and irregular
forms with their base (i).

    python scripts/build_wordnet_synonyms.py        # needs: apt install wordnet-base
"""

import argparse
import lzma
import re
from pathlib import Path

from knowarm.knowledge.vectors.words import DATA, shipped_vectors

PARTS = {"noun": "n", "verb": "v", "adj": "a"}
DERIVED = {"+", "\\", "<"}  # WordNet's pointers: derivation, pertainym, participle
MADE_OF = re.compile(
    r"\| *(?:made|consisting|composed)[^;]*? of (?:\([^)]*\) )?([a-z]+)"
)


def read_lines(path: Path) -> list[str]:
    """Return the lines of a file of WordNet below its licence."""
    return [line for line in path.read_text().splitlines() if not line.startswith("  ")]


def groups(wordnet: Path, senses: int) -> set[str]:
    """Return the lines of the table: a kind and words, of words that have shipped vectors."""
    known, sense, synsets = shipped_vectors("wordnet-gloss-50").index, {}, {}
    for name, part in PARTS.items():
        for line in read_lines(wordnet / f"index.{name}"):
            word, _, senses_of, *fields = line.split()
            for place, offset in enumerate(fields[-int(senses_of) :]):
                sense[word, part, offset] = place
        for line in read_lines(wordnet / f"data.{name}"):
            fields = line.split(" ")
            count = int(fields[3], 16)
            words = [
                re.sub(r"\(.*", "", fields[4 + 2 * i]).lower() for i in range(count)
            ]
            start = 5 + 2 * count
            pointers = [
                fields[start + 4 * i : start + 4 * i + 4]
                for i in range(int(fields[start - 1]))
            ]
            synsets[part, fields[0]] = words, pointers, line
    found = set()

    def usual(word: str, part: str, offset: str) -> bool:
        return (
            word.isalpha()
            and word in known
            and sense.get((word, part, offset), 99) < senses
        )

    for (part, offset), (words, pointers, line) in synsets.items():
        alike = sorted({word for word in words if usual(word, part, offset)})
        if len(alike) > 1:
            found.add(" ".join((part, *alike)))
        if (made := MADE_OF.search(line)) and part == "a":
            found |= {
                f"d {w} {made[1]}"
                for w in words
                if w.startswith(made[1][:3]) and w in known
            }
        for kind, target, target_part, ends in pointers:
            other = "a" if target_part == "s" else target_part
            if kind in DERIVED and ends != "0000" and (other, target) in synsets:
                pair = {
                    words[int(ends[:2], 16) - 1],
                    synsets[other, target][0][int(ends[2:], 16) - 1],
                }
                one, two = min(pair), max(pair)
                if one != two and all(w.isalpha() and w in known for w in pair):
                    found.add(f"d {one} {two}")
    for name in PARTS:
        for line in read_lines(wordnet / f"{name}.exc"):
            form, *bases = line.split()
            found |= {
                f"i {form} {base}" for base in bases if base in known and form.isalpha()
            }
    return found


def main() -> None:
    """Build the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--wordnet", type=Path, default=Path("/usr/share/wordnet"))
    parser.add_argument("--out", type=Path, default=DATA / "wordnet-synonyms.txt.xz")
    parser.add_argument("--senses", type=int, default=2)
    given = parser.parse_args()
    text = "\n".join(sorted(groups(given.wordnet, given.senses)))
    given.out.write_bytes(lzma.compress(text.encode(), preset=9))
    print(
        f"{len(text.splitlines())} lines -> {given.out} ({given.out.stat().st_size} bytes)"
    )


if __name__ == "__main__":
    main()
