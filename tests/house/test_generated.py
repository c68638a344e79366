"""The READMEs' generated tables are those of the code as it is, and the claims those that a command can make."""

import generated
import pytest
import validation


@pytest.mark.parametrize("path", generated.pages(), ids=lambda p: str(p.relative_to(generated.ROOT)))
def test_generated_tables_are_current(path):
    page = path.read_text()
    assert generated.renewed(page) == page, "stale: uv run python tests/house/generated.py --write"


def test_every_table_stands_somewhere():
    standing = {m[1] for path in generated.pages() for m in generated.BLOCK.finditer(path.read_text())}
    assert generated.BLOCKS.keys() - standing == set()


def test_every_claim_stands_on_the_page_with_its_command():
    for path in validation.PAGES:
        page = path.read_text()
        assert validation.renewed(page, {}) == page, "stale: uv run python tests/house/validation.py"
    standing = [m[1] for m in validation.RESULT.finditer(validation.PAGE.read_text())]
    assert standing == list(validation.CLAIMS)
