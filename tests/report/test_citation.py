"""What pages say of citing is what CITATION.cff says."""

from pathlib import Path

import yaml

from capsbayes.report import page as citation

STATED = yaml.safe_load((Path(__file__).parents[2] / "CITATION.cff").read_text(encoding="utf-8"))


def test_the_message_the_software_and_the_article():
    assert STATED["message"] == citation.MESSAGE
    for words in (STATED["title"], str(STATED["version"]), STATED["abstract"], STATED["authors"][0]["name"]):
        assert words in citation.SOFTWARE
    assert STATED["license"] in citation.SOFTWARE
    article = STATED["preferred-citation"]
    names = [f"{one['given-names']} {one['family-names']}" for one in article["authors"]]
    authors = f"{', '.join(names[:-1])} and {names[-1]}"
    assert f"{authors}. {article['title']}. {article['journal']}, {article['year']}." == citation.ARTICLE
    assert article["doi"] == citation.DOI
