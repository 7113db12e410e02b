//! The waveform that a run records.

use super::cosim::UnitMismatch;
use super::files::{Kind, Output};
use super::tell;
use anyhow::{Error, Result};
use dynrt::cosim::mismatch::Mismatch;
use dynrt::cosim::model::Trace;
use dynrt::report::{self, Staged};

/// The file of a waveform, and its cycles.
#[derive(clap::Args)]
pub struct WaveformArgs {
    /// Write a waveform as FST
    #[arg(long, value_name = "F.fst", requires = "cycles", value_parser = Kind::Fst)]
    trace: Option<Output>,
    /// The first cycle of the waveform
    #[arg(long, value_name = "CYCLE", default_value_t = 0, requires = "trace")]
    from: u64,
    /// Number of cycles in the waveform
    #[arg(long, value_name = "N", requires = "trace", value_parser = clap::value_parser!(u64).range(1..))]
    cycles: Option<u64>,
}

impl WaveformArgs {
    /// Gives `run` what it has to record. The waveform is published if the run ends well or with a mismatch.
    ///
    /// # Errors
    /// Those of the run, and of writing the file.
    pub fn around(&self, run: impl FnOnce(Option<Trace>) -> Result<()>) -> Result<()> {
        let file = (self.trace.as_ref())
            .map(|trace| Staged::empty(trace.path()))
            .transpose()?;
        let trace = file.as_ref().map(|file| Trace {
            path: file.temporary().to_path_buf(),
            from: self.from,
            cycles: self.cycles.unwrap_or(1),
        });
        let result = run(trace);
        let is_mismatch = |error: &Error| error.is::<Mismatch>() || error.is::<UnitMismatch>();
        if result.as_ref().err().is_none_or(is_mismatch) {
            report::publish_all(file)?;
        }
        result
    }

    /// Warns if the run ended before the first cycle of the waveform.
    pub fn check(&self, cycles: u64) {
        let WaveformArgs { trace, from, .. } = self;
        if let (Some(trace), true) = (trace, *from >= cycles) {
            tell(&format!(
                "warning: {trace}: the waveform is empty: it starts at cycle {from}, but the run has {cycles}; give a smaller --from"
            ));
        }
    }

    /// The line of a report that names the file; empty without a waveform.
    pub fn line(&self) -> String {
        let line = |trace| format!("waveform: {trace}\n");
        self.trace.as_ref().map(line).unwrap_or_default()
    }
}
