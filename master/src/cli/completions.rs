//! `omnibus completions SHELL`: a script that completes commands and options.

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

pub fn run(arguments: &Arguments, command: &mut Command) {
    clap_complete::generate(arguments.shell, command, "omnibus", &mut std::io::stdout());
}
