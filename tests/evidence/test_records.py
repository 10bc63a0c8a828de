"""Records are lines of JSON; one that was cut off is passed over."""

from evidence.records import Records


def test_records_come_back_in_order_and_go_on_after_a_cut_line(tmp_path):
    records = Records(tmp_path / "answers.jsonl")
    assert records.read() == []
    records.add({"seed": 1, "names": ["halo"]})
    with records.path.open("a") as file:
        file.write('{"seed": 2, "na')
    assert [record["seed"] for record in records.read()] == [1]
    records.add({"seed": 3})
    assert [record["seed"] for record in records.read()] == [1, 3]
