//! The words after a command's name.

use std::str::FromStr;

use anyhow::{Context as _, bail};

/// Words of the command line that no one has taken yet.
pub(crate) struct Arguments {
    words: Vec<String>,
}

impl Arguments {
    pub(crate) fn new(words: Vec<String>) -> Self {
        Self { words }
    }

    /// Takes a word such as `--write` and tells whether it was there.
    pub(crate) fn flag(&mut self, name: &str) -> bool {
        let before = self.words.len();
        self.words.retain(|word| word != name);
        self.words.len() < before
    }

    /// Takes an option with its value, as `--rounds 5` or `--rounds=5`.
    pub(crate) fn option<T: FromStr>(&mut self, name: &str) -> anyhow::Result<Option<T>>
    where
        T::Err: std::error::Error + Send + Sync + 'static,
    {
        let value = if let Some(at) = self.words.iter().position(|word| word == name) {
            if at + 1 == self.words.len() {
                bail!("{name} needs a value");
            }
            self.words.remove(at);
            self.words.remove(at)
        } else {
            let joined = format!("{name}=");
            let Some(at) = self.words.iter().position(|word| word.starts_with(&joined)) else {
                return Ok(None);
            };
            self.words.remove(at).split_off(joined.len())
        };
        value.parse().map(Some).with_context(|| format!("{name} {value}"))
    }

    /// Returns what is left, which may hold no option.
    pub(crate) fn rest(self) -> anyhow::Result<Vec<String>> {
        match self.words.iter().find(|word| word.starts_with('-')) {
            Some(word) => bail!("{word} is not known here; cargo xtask alone lists the commands"),
            None => Ok(self.words),
        }
    }

    /// Checks that nothing is left.
    pub(crate) fn finish(self) -> anyhow::Result<()> {
        match self.words.first() {
            Some(word) => bail!("{word} is not known here; cargo xtask alone lists the commands"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_taken_once() {
        let words = ["--rounds", "3", "name", "--write", "--problems=a b"];
        let mut arguments = Arguments::new(words.map(str::to_owned).to_vec());
        assert_eq!(arguments.option::<usize>("--rounds").unwrap(), Some(3));
        assert_eq!(arguments.option::<usize>("--rounds").unwrap(), None);
        assert_eq!(arguments.option::<String>("--problems").unwrap().as_deref(), Some("a b"));
        assert!(arguments.flag("--write") && !arguments.flag("--write"));
        assert_eq!(arguments.rest().unwrap(), ["name"]);
        assert!(Arguments::new(vec!["--what".to_owned()]).rest().is_err());
        assert!(Arguments::new(vec!["--rounds".to_owned()]).option::<usize>("--rounds").is_err());
    }
}
