//! `omnibus completions SHELL`: a script that completes commands and options.

use std::io::Write as _;

use clap::Command;
use clap_complete::Shell;

const EXAMPLES: &str = "Examples:
  omnibus completions bash > ~/.local/share/bash-completion/completions/omnibus
  omnibus completions zsh > ~/.zfunc/_omnibus
  omnibus completions fish > ~/.config/fish/completions/omnibus.fish";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The shell.
    shell: Shell,
}

pub fn run(arguments: &Arguments, command: &mut Command) -> anyhow::Result<()> {
    // The generator panics when a write fails, so it writes to memory.
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, command, "omnibus", &mut script);
    let mut out = std::io::stdout().lock();
    out.write_all(&script)?;
    out.flush()?;
    Ok(())
}
