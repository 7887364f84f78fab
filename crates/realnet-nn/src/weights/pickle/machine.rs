//! The stack machine that a pickle is a program for.

use std::collections::HashMap;

use super::{Id, Object, Pickle, PickleError, Value};

/// Most values a pickle may hold; a network of a thousand layers has some 10⁵.
const MAX_VALUES: usize = 4_000_000;
/// Most entries on the stack.
const MAX_STACK: usize = 2_000_000;
/// Most marks that may be open at once: the depth of nesting while reading.
const MAX_MARKS: usize = 10_000;
/// Highest memo index.
const MAX_MEMO: u64 = 4_000_000;

/// The machine's stack, marks and memo while it reads.
pub(super) struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

impl<'a> Machine<'a> {
    /// Runs the program at the start of `bytes` up to its STOP.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Pickle, PickleError> {
        let mut machine = Machine {
            bytes,
            at: 0,
            values: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        };
        let root = machine.run()?;
        Ok(Pickle { values: machine.values, root, consumed: machine.at })
    }

    fn run(&mut self) -> Result<Id, PickleError> {
        loop {
            let at = self.at;
            let opcode = self.u8()?;
            if opcode == b'.' {
                return self.pop();
            }
            self.step(opcode, at)?;
        }
    }

    fn step(&mut self, opcode: u8, at: usize) -> Result<(), PickleError> {
        let unsupported = |why| PickleError::Unsupported { opcode, at, why };
        match opcode {
            // Framing.
            0x80 => {
                let found = self.u8()?;
                if found > 5 {
                    return Err(PickleError::Protocol { found });
                }
                Ok(())
            }
            0x95 => self.take(8).map(drop),
            // Constants.
            b'N' => self.push(Value::None),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            b'I' => {
                let value = match self.line()? {
                    "00" => Value::Bool(false),
                    "01" => Value::Bool(true),
                    text => Value::Int(self.number(text, "integer")?),
                };
                self.push(value)
            }
            b'L' => {
                let text = self.line()?;
                let n = self.number(text.strip_suffix('L').unwrap_or(text), "integer")?;
                self.push(Value::Int(n))
            }
            b'J' => {
                let n = i32::from_le_bytes(self.array()?);
                self.push(Value::Int(i64::from(n)))
            }
            b'K' => {
                let n = self.u8()?;
                self.push(Value::Int(i64::from(n)))
            }
            b'M' => {
                let n = u16::from_le_bytes(self.array()?);
                self.push(Value::Int(i64::from(n)))
            }
            0x8a => {
                let n = self.u8()?;
                self.long(u64::from(n))
            }
            0x8b => {
                let n = self.len4()?;
                self.long(n)
            }
            b'F' => {
                let text = self.line()?;
                let f = self.number(text, "float")?;
                self.push(Value::Float(f))
            }
            b'G' => {
                let f = f64::from_be_bytes(self.array()?);
                self.push(Value::Float(f))
            }
            // Text and bytes.
            b'S' => {
                let text = self.line()?;
                let text = unquote(text).ok_or(PickleError::BadArgument { what: "string", at })?;
                self.push(Value::Str(text))
            }
            b'V' => {
                let text = self.line()?.to_owned();
                self.push(Value::Str(text))
            }
            b'X' | b'T' => {
                let n = self.len4()?;
                self.text(n)
            }
            0x8c | b'U' => {
                let n = self.u8()?;
                self.text(u64::from(n))
            }
            0x8d => {
                let n = u64::from_le_bytes(self.array()?);
                self.text(n)
            }
            b'B' => {
                let n = self.len4()?;
                self.blob(n)
            }
            b'C' => {
                let n = self.u8()?;
                self.blob(u64::from(n))
            }
            0x8e | 0x96 => {
                let n = u64::from_le_bytes(self.array()?);
                self.blob(n)
            }
            // The stack.
            b'(' => {
                self.limit("open marks", self.marks.len(), MAX_MARKS)?;
                self.marks.push(self.stack.len());
                Ok(())
            }
            b'0' => {
                // POP also removes a mark that is on top.
                if self.marks.last() == Some(&self.stack.len()) {
                    self.marks.pop();
                    return Ok(());
                }
                self.pop().map(drop)
            }
            b'1' => self.pop_mark().map(drop),
            b'2' => {
                let top = self.top()?;
                self.push_id(top)
            }
            // Containers.
            b')' => self.push(Value::Tuple(Vec::new())),
            b']' => self.push(Value::List(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            0x8f => self.push(Value::Set(Vec::new())),
            b't' => {
                let items = self.pop_mark()?;
                self.push(Value::Tuple(items))
            }
            b'l' => {
                let items = self.pop_mark()?;
                self.push(Value::List(items))
            }
            0x91 => {
                let items = self.pop_mark()?;
                self.push(Value::Set(items))
            }
            b'd' => {
                let items = self.pop_mark()?;
                let entries = self.pairs(&items)?;
                self.push(Value::Dict(entries))
            }
            0x85..=0x87 => {
                let count = usize::from(opcode - 0x84);
                let first = self.frame_start(count)?;
                let items = self.stack.split_off(first);
                self.push(Value::Tuple(items))
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])
            }
            b'e' | 0x90 => {
                let items = self.pop_mark()?;
                self.append(&items)
            }
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set_items(&[(key, value)])
            }
            b'u' => {
                let items = self.pop_mark()?;
                let entries = self.pairs(&items)?;
                self.set_items(&entries)
            }
            // The memo.
            b'p' => {
                let text = self.line()?;
                let index = self.number(text, "memo index")?;
                self.remember(index)
            }
            b'q' => {
                let index = u64::from(self.u8()?);
                self.remember(index)
            }
            b'r' => {
                let index = self.len4()?;
                self.remember(index)
            }
            0x94 => self.remember(self.memo.len() as u64),
            b'g' => {
                let text = self.line()?;
                let index = self.number(text, "memo index")?;
                self.recall(index)
            }
            b'h' => {
                let index = u64::from(self.u8()?);
                self.recall(index)
            }
            b'j' => {
                let index = self.len4()?;
                self.recall(index)
            }
            // Names and calls: recorded, never carried out.
            b'c' => {
                let module = self.line()?.to_owned();
                let name = self.line()?.to_owned();
                self.push(Value::Global { module, name })
            }
            0x93 => {
                let name = self.pop()?;
                let module = self.pop()?;
                match (self.value(module), self.value(name)) {
                    (Some(Value::Str(module)), Some(Value::Str(name))) => {
                        let value = Value::Global { module: module.clone(), name: name.clone() };
                        self.push(value)
                    }
                    _ => Err(PickleError::BadArgument { what: "name of a class", at }),
                }
            }
            b'R' | 0x81 => {
                let args = self.pop()?;
                let class = self.pop()?;
                self.object(class, args)
            }
            0x92 => {
                let _keywords = self.pop()?;
                let args = self.pop()?;
                let class = self.pop()?;
                self.object(class, args)
            }
            b'o' => {
                let mut items = self.pop_mark()?;
                if items.is_empty() {
                    return Err(PickleError::StackUnderflow { at });
                }
                let class = items.remove(0);
                let args = self.add(Value::Tuple(items))?;
                self.object(class, args)
            }
            b'i' => {
                let module = self.line()?.to_owned();
                let name = self.line()?.to_owned();
                let items = self.pop_mark()?;
                let class = self.add(Value::Global { module, name })?;
                let args = self.add(Value::Tuple(items))?;
                self.object(class, args)
            }
            b'b' => {
                let state = self.pop()?;
                let target = self.top()?;
                if let Some(Value::Object(object)) = self.values.get_mut(target.0 as usize) {
                    object.state = Some(state);
                }
                Ok(())
            }
            b'Q' => {
                let id = self.pop()?;
                self.push(Value::Persistent(id))
            }
            b'P' => {
                let text = self.line()?.to_owned();
                let id = self.add(Value::Str(text))?;
                self.push(Value::Persistent(id))
            }
            0x82..=0x84 => Err(unsupported("registered extensions")),
            0x97 | 0x98 => Err(unsupported("buffers outside the file")),
            _ => Err(unsupported("unknown operation")),
        }
    }

    // Input.

    fn take(&mut self, n: u64) -> Result<&'a [u8], PickleError> {
        let rest = self.bytes.get(self.at..).unwrap_or(&[]);
        let taken = usize::try_from(n).ok().and_then(|n| rest.get(..n));
        let Some(taken) = taken else {
            let needed = n.saturating_sub(rest.len() as u64);
            return Err(PickleError::Truncated { at: self.bytes.len(), needed });
        };
        self.at += taken.len();
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N as u64)?);
        Ok(array)
    }

    fn u8(&mut self) -> Result<u8, PickleError> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn len4(&mut self) -> Result<u64, PickleError> {
        Ok(u64::from(u32::from_le_bytes(self.array()?)))
    }

    fn line(&mut self) -> Result<&'a str, PickleError> {
        let at = self.at;
        let rest = self.bytes.get(at..).unwrap_or(&[]);
        let Some(end) = rest.iter().position(|&b| b == b'\n') else {
            return Err(PickleError::Truncated { at: self.bytes.len(), needed: 1 });
        };
        let line = self.take(end as u64)?;
        self.take(1)?;
        let text = std::str::from_utf8(line)
            .map_err(|_| PickleError::BadArgument { what: "text (not UTF-8)", at })?;
        Ok(text.strip_suffix('\r').unwrap_or(text))
    }

    fn number<T: std::str::FromStr>(
        &self,
        text: &str,
        what: &'static str,
    ) -> Result<T, PickleError> {
        text.trim().parse().map_err(|_| PickleError::BadArgument { what, at: self.at })
    }

    fn long(&mut self, len: u64) -> Result<(), PickleError> {
        let bytes = self.take(len)?;
        let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
        if bytes.len() > 8 {
            return self.push(Value::BigInt(bytes.to_vec()));
        }
        let mut array = [if negative { 0xff } else { 0 }; 8];
        for (to, from) in array.iter_mut().zip(bytes) {
            *to = *from;
        }
        self.push(Value::Int(i64::from_le_bytes(array)))
    }

    fn text(&mut self, len: u64) -> Result<(), PickleError> {
        let bytes = self.take(len)?;
        // Strings of Python 2 and lone surrogates are not UTF-8: damaged, not fatal.
        self.push(Value::Str(String::from_utf8_lossy(bytes).into_owned()))
    }

    fn blob(&mut self, len: u64) -> Result<(), PickleError> {
        let bytes = self.take(len)?;
        self.push(Value::Bytes(bytes.to_vec()))
    }

    // The stack.

    fn limit(&self, what: &'static str, count: usize, limit: usize) -> Result<(), PickleError> {
        if count >= limit {
            return Err(PickleError::Limit { what, limit: limit as u64, at: self.at });
        }
        Ok(())
    }

    fn value(&self, id: Id) -> Option<&Value> {
        self.values.get(id.0 as usize)
    }

    fn add(&mut self, value: Value) -> Result<Id, PickleError> {
        self.limit("values", self.values.len(), MAX_VALUES)?;
        let id = u32::try_from(self.values.len()).map_err(|_| PickleError::Limit {
            what: "values",
            limit: u64::from(u32::MAX),
            at: self.at,
        })?;
        self.values.push(value);
        Ok(Id(id))
    }

    fn push(&mut self, value: Value) -> Result<(), PickleError> {
        let id = self.add(value)?;
        self.push_id(id)
    }

    fn push_id(&mut self, id: Id) -> Result<(), PickleError> {
        self.limit("values on the stack", self.stack.len(), MAX_STACK)?;
        self.stack.push(id);
        Ok(())
    }

    /// Index of the first of the `count` topmost entries, none of them below the last mark.
    fn frame_start(&self, count: usize) -> Result<usize, PickleError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        let first = self.stack.len().checked_sub(count).filter(|&first| first >= floor);
        first.ok_or(PickleError::StackUnderflow { at: self.at })
    }

    fn pop(&mut self) -> Result<Id, PickleError> {
        self.frame_start(1)?;
        self.stack.pop().ok_or(PickleError::StackUnderflow { at: self.at })
    }

    fn top(&self) -> Result<Id, PickleError> {
        self.frame_start(1)?;
        self.stack.last().copied().ok_or(PickleError::StackUnderflow { at: self.at })
    }

    fn pop_mark(&mut self) -> Result<Vec<Id>, PickleError> {
        let mark = self.marks.pop().filter(|&mark| mark <= self.stack.len());
        let mark = mark.ok_or(PickleError::StackUnderflow { at: self.at })?;
        Ok(self.stack.split_off(mark))
    }

    fn pairs(&self, items: &[Id]) -> Result<Vec<(Id, Id)>, PickleError> {
        let (pairs, rest) = items.as_chunks::<2>();
        if !rest.is_empty() {
            return Err(PickleError::BadArgument {
                what: "dictionary (odd number of items)",
                at: self.at,
            });
        }
        Ok(pairs.iter().map(|&[key, value]| (key, value)).collect())
    }

    fn object(&mut self, class: Id, args: Id) -> Result<(), PickleError> {
        self.push(Value::Object(Box::new(Object {
            class,
            args,
            state: None,
            items: Vec::new(),
            entries: Vec::new(),
        })))
    }

    fn append(&mut self, items: &[Id]) -> Result<(), PickleError> {
        let target = self.top()?;
        match self.values.get_mut(target.0 as usize) {
            Some(Value::List(list) | Value::Set(list)) => list.extend_from_slice(items),
            Some(Value::Object(object)) => object.items.extend_from_slice(items),
            _ => return Err(PickleError::BadArgument { what: "list to append to", at: self.at }),
        }
        Ok(())
    }

    fn set_items(&mut self, entries: &[(Id, Id)]) -> Result<(), PickleError> {
        let target = self.top()?;
        match self.values.get_mut(target.0 as usize) {
            Some(Value::Dict(dict)) => dict.extend_from_slice(entries),
            Some(Value::Object(object)) => object.entries.extend_from_slice(entries),
            _ => {
                return Err(PickleError::BadArgument { what: "dictionary to add to", at: self.at });
            }
        }
        Ok(())
    }

    fn remember(&mut self, index: u64) -> Result<(), PickleError> {
        if index >= MAX_MEMO {
            return Err(PickleError::Limit { what: "memo entries", limit: MAX_MEMO, at: self.at });
        }
        let top = self.top()?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn recall(&mut self, index: u64) -> Result<(), PickleError> {
        let found = self.memo.get(&index).copied();
        let id = found.ok_or(PickleError::UnknownMemo { index, at: self.at })?;
        self.push_id(id)
    }
}

/// Text of a quoted string of protocol 0, with the common escapes.
fn unquote(text: &str) -> Option<String> {
    let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    let inner = text.strip_prefix(quote)?.strip_suffix(quote)?;
    let mut out = String::with_capacity(inner.len());
    let mut chars = inner.chars();
    while let Some(c) = chars.next() {
        if c != '\\' {
            out.push(c);
            continue;
        }
        match chars.next()? {
            'n' => out.push('\n'),
            'r' => out.push('\r'),
            't' => out.push('\t'),
            'x' => {
                let code = chars.next()?.to_digit(16)? * 16 + chars.next()?.to_digit(16)?;
                out.push(char::from_u32(code)?);
            }
            other => out.push(other),
        }
    }
    Some(out)
}
