"""Every reader takes its own files, and raises only `InputError` for mutants; `fuzz/run.py` tries more of them."""

import pytest

from chromaperture.system.errors import InputError
from fuzz.mutants import mutant
from fuzz.readers import READERS


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_a_mutant_is_read_or_refused_in_one_line(tmp_path, name, rng):
    reader = READERS[name]
    reader.prepare(tmp_path)
    path = tmp_path / reader.file
    path.parent.mkdir(exist_ok=True)
    seeds = reader.seeds()
    for content in seeds:
        path.write_bytes(content)
        reader.read(path)
    refused = 0
    for _ in range(60):
        path.write_bytes(mutant(seeds[rng.integers(len(seeds))], rng, is_text=reader.is_text))
        try:
            reader.read(path)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused or name == "frame"  # a damaged frame is left out, and the others are replayed
