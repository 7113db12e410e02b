//! `dynrt completions` and `dynrt man`: shell completions and manual pages.

use super::files::{Kind, Output};
use super::{command, counted, print, print_as_it_is};
use anyhow::Result;
use clap::builder::Resettable;
use clap_complete::Shell;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};
use dynrt::report::folder::{Content, Folder};

const COMPLETIONS_HELP: &str = "\
Examples:
  dynrt completions bash > ~/.local/share/bash-completion/completions/dynrt
  dynrt completions zsh > ~/.zfunc/_dynrt
  dynrt completions fish > ~/.config/fish/completions/dynrt.fish";

/// Print a completion script for a shell
#[derive(clap::Args)]
#[command(after_help = COMPLETIONS_HELP)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

pub fn completions(args: &CompletionsArgs) -> Result<()> {
    let mut text = vec![];
    clap_complete::generate(args.shell, &mut command(), "dynrt", &mut text);
    print_as_it_is(&String::from_utf8_lossy(&text))
}

const MAN_HELP: &str = "\
Writes dynrt.1 and one page per command, such as dynrt-cosim.1. DIR is created if it does not exist. Earlier pages in it are replaced
as a whole; a folder with any other file is refused.

Examples:
  dynrt man --out build/man1 && man build/man1/dynrt-cosim.1
  dynrt man --out /tmp/man1 && install -m 644 /tmp/man1/*.1 /usr/local/share/man/man1/";

/// Write the manual pages, one per command
#[derive(clap::Args)]
#[command(after_help = MAN_HELP)]
pub struct ManArgs {
    /// The output folder
    #[arg(long, value_name = "DIR", value_parser = Kind::Folder)]
    out: Output,
}

/// A folder holds manual pages if it contains dynrt.1; all pages of dynrt belong to it.
const CONTENT: Content = Content {
    name: "manual pages",
    owned: |_, names| {
        let is_page = |name: &&String| {
            let name = name.strip_suffix(".1");
            name.is_some_and(|name| name == "dynrt" || name.starts_with("dynrt-"))
        };
        names
            .contains("dynrt.1")
            .then(|| names.iter().filter(is_page).cloned().collect())
    },
};

pub fn run(args: &ManArgs) -> Result<()> {
    let folder = Folder::begin(args.out.path(), CONTENT)?;
    let mut all = command().disable_help_subcommand(true);
    all.build();
    let mut count = 0;
    let mut open = vec![all];
    while let Some(next) = open.pop() {
        open.extend(next.get_subcommands().cloned());
        let (name, text) = page(next)?;
        folder.write(&name, &text)?;
        count += 1;
    }
    folder.publish()?;
    print(&format!(
        "{}: {}\n",
        args.out,
        counted(count, "manual page")
    ))
}

/// The name and text of the manual page of a command. The text after the options in its help keeps its line breaks.
fn page(command: clap::Command) -> Result<(String, String)> {
    let notes = command.get_after_help().map(ToString::to_string);
    let man = Man::new(command.after_help(Resettable::Reset)).manual("DynRT");
    let mut text = vec![];
    man.render(&mut text)?;
    let notes = notes.unwrap_or_default();
    let (notes, examples) = match notes.split_once("Examples:\n") {
        Some((notes, examples)) => (notes.to_string(), examples.to_string()),
        None => (notes, String::new()),
    };
    for (heading, lines) in [("NOTES", notes), ("EXAMPLES", examples)] {
        if lines.trim().is_empty() {
            continue;
        }
        let mut section = Roff::default();
        section.control("SH", [heading]);
        section.control("nf", []);
        for line in lines.trim_end().lines() {
            section.text([roman(line)]);
        }
        section.control("fi", []);
        section.to_writer(&mut text)?;
    }
    Ok((man.get_filename(), String::from_utf8(text)?))
}
