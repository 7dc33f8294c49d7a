"""A reader of HTML: it checks that tags are closed in order, and returns tags, attributes, text and table cells."""

import re
from html.parser import HTMLParser

VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """Checks that every tag is closed in order; keeps tags, attributes and the cells of each table."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.attributes, self.text, self.rows = [], [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes.extend((tag, key, value) for key, value in attrs)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append([])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes.extend((tag, key, value) for key, value in attrs)

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1].append(data)
        if not {"style", "script"} & set(self.open):
            self.text.append(data)

    @property
    def words(self):
        return re.sub(r"\s+", " ", "".join(self.text))

    def assert_alone(self, text, reached=lambda tag, link: False):
        """Nothing is loaded from elsewhere; every link leads to a place of the page, or to what is `reached`."""
        assert self.tags.count("html") == self.tags.count("main") == self.tags.count("h1") == 1
        assert not {"link", "iframe", "object", "embed", "base"} & {*self.tags}
        ids = [value for _, key, value in self.attributes if key == "id"]
        assert len(ids) == len({*ids})
        used = set(re.findall(r"url\(#([^)]+)\)", text))
        for tag, key, link in self.attributes:
            if key in ("src", "href", "xlink:href", "srcset", "action"):
                assert link.startswith(("#", "data:image/png;base64,")) or reached(tag, link), link
                used |= {link[1:]} if link.startswith("#") else set()
            elif not key.startswith("xmlns") and key != "content":
                assert "//" not in (link or "")
        assert used <= {*ids}
        assert "@import" not in text and not re.findall(r"url\((?!#)", text)
        assert "default-src 'none'" in text
