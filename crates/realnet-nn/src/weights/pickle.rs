//! A reader of Python pickles that never runs anything.
//!
//! A pickle is a program for a small stack machine. This interpreter builds a
//! plain tree of values from it: names of functions and classes stay names,
//! calls stay records of what would have been called with what. Nothing is
//! imported, called or looked up, whatever the file asks for.
//!
//! All values live in one arena and refer to each other by index, so shared
//! and recursive structures cost nothing extra and are dropped without
//! recursion. Memory is bounded by the length of the input: each operation
//! makes at most one value, and no length in the file is believed before the
//! bytes are there.

mod machine;

use thiserror::Error;

/// What is wrong with a pickle.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum PickleError {
    /// The bytes end inside an operation.
    #[error("the pickle ends at byte {at}: {needed} more bytes were expected")]
    Truncated {
        /// Where the bytes were looked for.
        at: usize,
        /// How many were missing at least.
        needed: u64,
    },
    /// An operation that is unknown or has no meaning in a checkpoint.
    #[error("pickle operation 0x{opcode:02x} at byte {at} is not supported ({why})")]
    Unsupported {
        /// The code.
        opcode: u8,
        /// Where it is.
        at: usize,
        /// Why.
        why: &'static str,
    },
    /// A higher protocol than 5.
    #[error("pickle protocol {found} is not supported (0 to 5 are)")]
    Protocol {
        /// The version in the file.
        found: u8,
    },
    /// An operation found too few values, or no mark, on the stack.
    #[error("damaged pickle: the stack is empty at byte {at}")]
    StackUnderflow {
        /// Where.
        at: usize,
    },
    /// A reference to a value that was not memorised.
    #[error("damaged pickle: memo entry {index} asked for at byte {at} was never stored")]
    UnknownMemo {
        /// The entry.
        index: u64,
        /// Where.
        at: usize,
    },
    /// An argument that cannot be read.
    #[error("damaged pickle: bad {what} at byte {at}")]
    BadArgument {
        /// What was expected.
        what: &'static str,
        /// Where.
        at: usize,
    },
    /// A limit was passed.
    #[error("pickle refused at byte {at}: more than {limit} {what}")]
    Limit {
        /// What there is too much of.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// Where.
        at: usize,
    },
}

/// Index of a value in its [`Pickle`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Id(u32);

/// One value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// `None`.
    None,
    /// A truth value.
    Bool(bool),
    /// An integer of up to 64 bits.
    Int(i64),
    /// A longer integer, as little-endian two's complement bytes.
    BigInt(Vec<u8>),
    /// A float.
    Float(f64),
    /// Text.
    Str(String),
    /// Bytes.
    Bytes(Vec<u8>),
    /// A list.
    List(Vec<Id>),
    /// A tuple.
    Tuple(Vec<Id>),
    /// A set or frozen set.
    Set(Vec<Id>),
    /// A dictionary in order of insertion.
    Dict(Vec<(Id, Id)>),
    /// The name of a class or function.
    Global {
        /// Module it would be imported from.
        module: String,
        /// Name in that module.
        name: String,
    },
    /// The record of a call or of a new instance. Nothing was called.
    Object(Box<Object>),
    /// A reference to something outside the pickle, such as a tensor's storage.
    Persistent(Id),
}

/// The record of a call or of a new instance.
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// What would have been called.
    pub class: Id,
    /// The arguments, normally a tuple.
    pub args: Id,
    /// What would have been given to `__setstate__`.
    pub state: Option<Id>,
    /// Items appended (list subclasses, deques).
    pub items: Vec<Id>,
    /// Entries set (dict subclasses).
    pub entries: Vec<(Id, Id)>,
}

/// A decoded pickle.
#[derive(Debug, Clone)]
pub struct Pickle {
    values: Vec<Value>,
    root: Id,
    consumed: usize,
}

static NONE: Value = Value::None;

impl Pickle {
    /// Decodes the pickle at the start of `bytes`, up to its STOP.
    ///
    /// # Errors
    /// [`PickleError`] for anything but a well-formed pickle within the limits.
    pub fn parse(bytes: &[u8]) -> Result<Pickle, PickleError> {
        machine::Machine::parse(bytes)
    }

    /// The outermost value.
    pub fn root(&self) -> Id {
        self.root
    }

    /// Bytes read, STOP included.
    pub fn consumed(&self) -> usize {
        self.consumed
    }

    /// All values, in the order they were made.
    pub fn ids(&self) -> impl Iterator<Item = Id> {
        (0..self.values.len()).filter_map(|n| u32::try_from(n).ok()).map(Id)
    }

    /// The value at an index.
    pub fn get(&self, id: Id) -> &Value {
        self.values.get(id.0 as usize).unwrap_or(&NONE)
    }

    /// Text of a string.
    pub fn str(&self, id: Id) -> Option<&str> {
        match self.get(id) {
            Value::Str(s) => Some(s),
            _ => None,
        }
    }

    /// An integer; truth values are 0 and 1.
    pub fn int(&self, id: Id) -> Option<i64> {
        match self.get(id) {
            Value::Int(n) => Some(*n),
            Value::Bool(b) => Some(i64::from(*b)),
            _ => None,
        }
    }

    /// Items of a list or tuple. `torch.Size` and other calls that wrap one
    /// tuple count as that tuple.
    pub fn sequence(&self, id: Id) -> Option<&[Id]> {
        match self.get(id) {
            Value::List(items) | Value::Tuple(items) => Some(items),
            Value::Object(o) if self.global(o.class) == Some(("torch", "Size")) => {
                let inner = self.sequence_shallow(o.args)?.first()?;
                self.sequence_shallow(*inner)
            }
            _ => None,
        }
    }

    fn sequence_shallow(&self, id: Id) -> Option<&[Id]> {
        match self.get(id) {
            Value::List(items) | Value::Tuple(items) => Some(items),
            _ => None,
        }
    }

    /// Module and name of a class or function.
    ///
    /// Old files wrap classes in a persistent reference `('module', class, …)`.
    pub fn global(&self, id: Id) -> Option<(&str, &str)> {
        let id = match self.get(id) {
            Value::Persistent(inner) => match self.sequence_shallow(*inner)? {
                [tag, class, ..] if self.str(*tag) == Some("module") => *class,
                _ => return None,
            },
            _ => id,
        };
        match self.get(id) {
            Value::Global { module, name } => Some((module, name)),
            _ => None,
        }
    }

    /// Entries of a dictionary or of an object of `collections.OrderedDict`,
    /// `defaultdict` and the like. Of a key given twice both are returned.
    pub fn entries(&self, id: Id) -> Option<Vec<(Id, Id)>> {
        match self.get(id) {
            Value::Dict(entries) => Some(entries.clone()),
            Value::Object(o) => {
                if !matches!(self.global(o.class)?, ("collections", "OrderedDict" | "defaultdict"))
                {
                    return None;
                }
                // Python 2 gives the entries as a list of pairs.
                let pairs = self
                    .sequence_shallow(o.args)
                    .and_then(|args| self.sequence_shallow(*args.first()?))
                    .unwrap_or(&[]);
                let pair = |id: &Id| match self.sequence_shallow(*id)? {
                    [key, value] => Some((*key, *value)),
                    _ => None,
                };
                Some(pairs.iter().filter_map(pair).chain(o.entries.iter().copied()).collect())
            }
            _ => None,
        }
    }

    /// How many entries [`Pickle::entries`] would return at most, without copying them.
    pub fn entry_count(&self, id: Id) -> usize {
        match self.get(id) {
            Value::Dict(entries) => entries.len(),
            Value::Object(o) => {
                let pairs = self
                    .sequence_shallow(o.args)
                    .and_then(|args| self.sequence_shallow(*args.first()?))
                    .unwrap_or(&[]);
                pairs.len() + o.entries.len()
            }
            _ => 0,
        }
    }

    /// The value of a text key in a dictionary; the last one counts.
    pub fn lookup(&self, dict: Id, key: &str) -> Option<Id> {
        let found = |entries: &[(Id, Id)]| {
            entries.iter().rev().find(|(k, _)| self.str(*k) == Some(key)).map(|(_, v)| *v)
        };
        match self.get(dict) {
            Value::Dict(entries) => found(entries),
            _ => found(&self.entries(dict)?),
        }
    }

    /// The attributes of an instance: the dictionary given to `__setstate__`,
    /// or the first half of a pair `(attributes, slots)`.
    pub fn attributes(&self, id: Id) -> Option<Id> {
        let Value::Object(object) = self.get(id) else { return None };
        let state = object.state?;
        match self.get(state) {
            Value::Tuple(items) => items.first().copied(),
            _ => Some(state),
        }
    }

    /// A short description for error texts.
    pub fn describe(&self, id: Id) -> String {
        match self.get(id) {
            Value::None => "None".into(),
            Value::Bool(_) => "a truth value".into(),
            Value::Int(_) | Value::BigInt(_) => "an integer".into(),
            Value::Float(_) => "a float".into(),
            Value::Str(_) => "text".into(),
            Value::Bytes(_) => "bytes".into(),
            Value::List(_) => "a list".into(),
            Value::Tuple(_) => "a tuple".into(),
            Value::Set(_) => "a set".into(),
            Value::Dict(_) => "a dictionary".into(),
            Value::Global { module, name } => format!("the name {module}.{name}"),
            Value::Persistent(_) => "a stored reference".into(),
            Value::Object(o) => match self.global(o.class) {
                Some((module, name)) => format!("an object of {module}.{name}"),
                None => "an object of unknown class".into(),
            },
        }
    }
}
