//! Arguments, and which of them the user gave.

use clap::{ArgMatches, Args, Command, Error, FromArgMatches, parser::ValueSource};
use std::collections::BTreeSet;

/// Arguments whose defaults are not the same for all commands that have them.
pub(super) trait Defaults {
    /// Default by name of the field.
    const DEFAULTS: &'static [(&'static str, &'static str)];
}

/// Arguments, and the names of the fields that were on the command line: these win over a
/// file of options, and a file wins over the defaults.
#[derive(Debug)]
pub(crate) struct Given<T> {
    pub(super) args: T,
    names: BTreeSet<String>,
}

impl<T> Given<T> {
    /// Whether the field was on the command line.
    pub(super) fn has(&self, name: &str) -> bool {
        self.names.contains(name)
    }

    /// The fields that were on the command line.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.names.iter().map(String::as_str)
    }
}

/// Of the arguments alone: groups of them have ids, too.
fn names<T: Args>(matches: &ArgMatches) -> BTreeSet<String> {
    let command = T::augment_args(Command::new("arguments"));
    let ids = command.get_arguments().map(|arg| arg.get_id().as_str());
    let said = |id: &&str| matches.value_source(id) == Some(ValueSource::CommandLine);
    ids.filter(said).map(str::to_owned).collect()
}

impl<T: Args> FromArgMatches for Given<T> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self { args: T::from_arg_matches(matches)?, names: names::<T>(matches) })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        self.args.update_from_arg_matches(matches)?;
        self.names.extend(names::<T>(matches));
        Ok(())
    }
}

fn with_defaults<T: Defaults>(command: Command) -> Command {
    T::DEFAULTS.iter().fold(command, |command, (name, value)| {
        command.mut_arg(name, |arg| arg.default_value(*value))
    })
}

impl<T: Args + Defaults> Args for Given<T> {
    fn augment_args(command: Command) -> Command {
        with_defaults::<T>(T::augment_args(command))
    }

    fn augment_args_for_update(command: Command) -> Command {
        with_defaults::<T>(T::augment_args_for_update(command))
    }
}
