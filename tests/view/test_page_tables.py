"""Tables of pages: what stands on the right."""

from modsim3d.view.pages import page


def test_an_unknown_number_stands_where_the_numbers_of_its_column_do() -> None:
    table = page.table([("a", "–", "–"), ("b", "2", "yes")], ("name", "count", "word"))
    assert '<th class="number">count</th>' in table and '<td class="number">–</td><td>–</td>' in table
    assert "<th>word</th>" in table and '<td class="number">2</td><td>yes</td>' in table
