"""Text becomes HTML that shows it, whatever stands in it."""

from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from postproc.report.kit.html import Html, element, joined

TEXT = st.text(st.characters(exclude_characters="\r\0", exclude_categories=["Cs"]))


class Read(HTMLParser):
    """What a reader of HTML sees."""

    def __init__(self, text):
        super().__init__()
        self.seen = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        self.seen.append(f"/{tag}")

    def handle_data(self, data):
        self.seen.append(f"text {data}")


@given(TEXT.filter(bool), TEXT.filter(bool))
def test_any_text_comes_back(text, told):
    html = element("p", text, title=told)
    assert Read(html).seen == [("p", {"title": told}), f"text {text}", "/p"]


def test_html_is_not_escaped_again():
    inner = element("b", "<", class_="x")
    assert element("p", inner, Html("&nbsp;")) == '<p><b class="x">&lt;</b>&nbsp;</p>'
    assert joined(["<", inner]) == '&lt;<b class="x">&lt;</b>'


def test_attributes_that_say_nothing_are_left_out():
    assert element("td", data_sort=0.0, class_="", scope=None) == '<td data-sort="0.0"></td>'
    assert element("meta", charset="utf-8") == '<meta charset="utf-8">'
