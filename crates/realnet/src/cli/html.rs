//! Words on a page.

/// A text that may stand between tags.
pub(crate) fn text(words: &str) -> String {
    words.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// A text that may stand between tags and in the quotes of an attribute.
pub(crate) fn escape(words: &str) -> String {
    text(words).replace('"', "&quot;").replace('\'', "&#39;")
}
