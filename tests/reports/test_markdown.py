"""Words and numbers of the reports' tables."""

from reports import markdown


def test_a_span_is_the_mean_with_its_range_and_one_number_without_one():
    assert markdown.span([1.0, None, 4.0, 2.5]) == '2.5 (1 to 4)'
    assert markdown.span([3, 3]) == '3'
    assert markdown.span([None]) == ''
