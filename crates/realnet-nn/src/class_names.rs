//! Class names as text: a Python or JSON list or dictionary.

use std::collections::BTreeMap;

use thiserror::Error;

/// Why a text is not a list of names.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[error("class names: {what} at character {at}")]
pub struct NamesError {
    /// What is wrong.
    pub what: &'static str,
    /// Where, counted in characters from 0.
    pub at: usize,
}

/// Reads class names from text.
///
/// Ultralytics writes the text of a Python dictionary, `{0: 'person', 1: "driver's seat"}`;
/// lists (`['a', 'b']`) and the same in JSON (`{"0": "a"}`) are read too.
///
/// # Errors
/// [`NamesError`] if the text is neither, or the numbers are not 0, 1, 2, ….
pub fn parse_names(text: &str) -> Result<Vec<String>, NamesError> {
    let mut parser = Parser { chars: text.chars().collect(), at: 0 };
    parser.space();
    let names = match parser.peek() {
        Some('[') => parser.list('[', ']')?,
        Some('(') => parser.list('(', ')')?,
        Some('{') => parser.dictionary()?,
        _ => return Err(parser.error("a list or dictionary is missing")),
    };
    parser.space();
    match parser.peek() {
        None => Ok(names),
        Some(_) => Err(parser.error("more text after the end")),
    }
}

/// Writes class names as the text of a Python dictionary.
pub(super) fn write_names(names: &[String]) -> String {
    let entries: Vec<String> =
        names.iter().enumerate().map(|(i, name)| format!("{i}: {}", quote(name))).collect();
    format!("{{{}}}", entries.join(", "))
}

/// Quotes like Python's `repr`: single quotes unless only they occur inside.
fn quote(text: &str) -> String {
    let quote = if text.contains('\'') && !text.contains('"') { '"' } else { '\'' };
    let mut out = String::from(quote);
    for c in text.chars() {
        match c {
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            c if c == quote => {
                out.push('\\');
                out.push(c);
            }
            c if c.is_control() => out.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => out.push(c),
        }
    }
    out.push(quote);
    out
}

struct Parser {
    chars: Vec<char>,
    at: usize,
}

impl Parser {
    fn error(&self, what: &'static str) -> NamesError {
        NamesError { what, at: self.at }
    }

    fn peek(&self) -> Option<char> {
        self.chars.get(self.at).copied()
    }

    fn next(&mut self) -> Option<char> {
        let c = self.peek()?;
        self.at += 1;
        Some(c)
    }

    fn space(&mut self) {
        while self.peek().is_some_and(char::is_whitespace) {
            self.at += 1;
        }
    }

    fn expect(&mut self, c: char, what: &'static str) -> Result<(), NamesError> {
        self.space();
        if self.peek() != Some(c) {
            return Err(self.error(what));
        }
        self.at += 1;
        Ok(())
    }

    /// After an item: true if another follows. A comma before the end is allowed.
    fn more(&mut self, close: char) -> Result<bool, NamesError> {
        self.space();
        let comma = self.peek() == Some(',');
        if comma {
            self.at += 1;
            self.space();
        }
        if self.peek() == Some(close) {
            self.at += 1;
            return Ok(false);
        }
        if comma { Ok(true) } else { Err(self.error("a comma or the end is missing")) }
    }

    fn list(&mut self, open: char, close: char) -> Result<Vec<String>, NamesError> {
        self.expect(open, "the start of the list is missing")?;
        let mut names = Vec::new();
        self.space();
        if self.peek() == Some(close) {
            self.at += 1;
            return Ok(names);
        }
        loop {
            self.space();
            names.push(self.string()?);
            if !self.more(close)? {
                return Ok(names);
            }
        }
    }

    fn dictionary(&mut self) -> Result<Vec<String>, NamesError> {
        self.expect('{', "the start of the dictionary is missing")?;
        let mut names = BTreeMap::new();
        self.space();
        if self.peek() == Some('}') {
            self.at += 1;
            return Ok(Vec::new());
        }
        loop {
            self.space();
            let key = match self.peek() {
                Some('\'' | '"') => self.string()?,
                _ => self.digits(),
            };
            let index: usize =
                key.trim().parse().map_err(|_| self.error("a class number is missing"))?;
            self.expect(':', "a colon is missing")?;
            self.space();
            let name = self.string()?;
            if names.insert(index, name).is_some() {
                return Err(self.error("a class number given twice"));
            }
            if !self.more('}')? {
                break;
            }
        }
        if !names.keys().copied().eq(0..names.len()) {
            return Err(self.error("the class numbers are not 0, 1, 2, …"));
        }
        Ok(names.into_values().collect())
    }

    fn digits(&mut self) -> String {
        let mut digits = String::new();
        while let Some(c) = self.peek().filter(char::is_ascii_digit) {
            digits.push(c);
            self.at += 1;
        }
        digits
    }

    fn string(&mut self) -> Result<String, NamesError> {
        let Some(quote @ ('\'' | '"')) = self.peek() else {
            return Err(self.error("a quoted name is missing"));
        };
        self.at += 1;
        let mut out = String::new();
        loop {
            match self.next().ok_or_else(|| self.error("the text ends inside a name"))? {
                c if c == quote => return Ok(out),
                '\\' => self.escape(&mut out)?,
                c => out.push(c),
            }
        }
    }

    fn escape(&mut self, out: &mut String) -> Result<(), NamesError> {
        let c = self.next().ok_or_else(|| self.error("the text ends inside a name"))?;
        let plain = match c {
            'n' => '\n',
            't' => '\t',
            'r' => '\r',
            'b' => '\u{8}',
            'f' => '\u{c}',
            'x' => self.hex(2)?,
            'u' => self.unicode()?,
            'U' => self.hex(8)?,
            '\\' | '\'' | '"' | '/' => c,
            other => {
                // Python keeps the backslash of unknown escapes.
                out.push('\\');
                other
            }
        };
        out.push(plain);
        Ok(())
    }

    fn code(&mut self, digits: usize) -> Result<u32, NamesError> {
        (0..digits).try_fold(0u32, |code, _| {
            let digit = self.next().and_then(|c| c.to_digit(16));
            let digit = digit.ok_or_else(|| self.error("a bad escape"))?;
            Ok(code.wrapping_mul(16).wrapping_add(digit))
        })
    }

    fn hex(&mut self, digits: usize) -> Result<char, NamesError> {
        let code = self.code(digits)?;
        char::from_u32(code).ok_or_else(|| self.error("a bad escape"))
    }

    /// `\uXXXX`, with the second half of a surrogate pair as JSON writes it.
    fn unicode(&mut self) -> Result<char, NamesError> {
        let first = self.code(4)?;
        if !(0xd800..0xdc00).contains(&first) {
            return char::from_u32(first).ok_or_else(|| self.error("a bad escape"));
        }
        if self.next() != Some('\\') || self.next() != Some('u') {
            return Err(self.error("a bad escape"));
        }
        let second = self.code(4)?;
        let low = second.checked_sub(0xdc00).filter(|low| *low < 0x400);
        let low = low.ok_or_else(|| self.error("a bad escape"))?;
        char::from_u32(0x10000 + ((first - 0xd800) << 10) + low)
            .ok_or_else(|| self.error("a bad escape"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn python_and_json_names_are_read() {
        let read = |text: &str| parse_names(text).unwrap();
        assert_eq!(read("{0: 'person', 1: \"driver's seat\"}"), ["person", "driver's seat"]);
        assert_eq!(read("{1: 'b', 0: 'a',}"), ["a", "b"]);
        assert_eq!(read("['a', \"b\"]"), ["a", "b"]);
        assert_eq!(read("('a',)"), ["a"]);
        assert_eq!(read(r#"{"0": "caf\u00e9", "1": "\ud83d\ude97"}"#), ["café", "🚗"]);
        assert_eq!(read(r"['it\'s', 'a\\b', 'c\x41']"), ["it's", "a\\b", "cA"]);
        assert_eq!(read(" [ ] "), [] as [&str; 0]);
    }

    #[test]
    fn bad_names_are_refused() {
        for bad in [
            "",
            "person",
            "{0: 'a'",
            "{0 'a'}",
            "{1: 'a'}",
            "{0: 'a', 0: 'b'}",
            "['a' 'b']",
            "['a",
            "['a'] x",
            "{0: a}",
            r"['\ud83d']",
            r"['\U00110000']",
        ] {
            assert!(parse_names(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn written_names_are_read_back() {
        let names = [
            "person",
            "it's",
            "say \"hi\"",
            "both ' and \"",
            "back\\slash",
            "line\nend",
            "é🚗",
            "\u{7}",
        ]
        .map(str::to_owned);
        let text = write_names(&names);
        assert!(text.starts_with("{0: 'person', 1: \"it's\", 2: 'say \"hi\"', "), "{text}");
        assert_eq!(parse_names(&text).unwrap(), names);
    }
}
