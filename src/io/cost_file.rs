//! Saves learned costs in a YAML file.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::yaml;
use crate::anytime::cost_model::{CostEntry, CostModel};
use crate::output;

/// Why costs cannot be read or written.
#[derive(Debug, Error)]
pub enum CostFileError {
    /// The operating system reported an error.
    #[error("cannot {action} the cost file {}: {problem}", path.display())]
    System {
        /// The operation that failed.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        problem: io::Error,
    },
    /// The content is not a list of costs.
    #[error("{} is not a cost file (delete it; a new one is written on exit): {problem}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong, and in which line.
        problem: String,
    },
}

/// Loads the file into `costs`. Returns whether the file exists.
pub fn read(path: &Path, costs: &mut CostModel) -> Result<bool, CostFileError> {
    let text = match std::fs::read_to_string(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
        text => text.map_err(|problem| CostFileError::System { action: "read", path: path.into(), problem })?,
    };
    let content = |problem| CostFileError::Content { path: path.into(), problem };
    let entries: Vec<CostEntry> = yaml::from_str(&text).map_err(content)?;
    costs.restore(&entries);
    Ok(true)
}

/// Writes `costs` to the file.
pub fn write(path: &Path, costs: &CostModel) -> Result<(), CostFileError> {
    let system = |problem| CostFileError::System { action: "write", path: path.into(), problem };
    let text = serde_saphyr::to_string(&costs.entries()).map_err(|error| system(io::Error::other(error.to_string())))?;
    output::write(path, text).map_err(system)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anytime::cost_model::Phase;
    use std::time::Duration;

    #[test]
    fn costs_are_saved_and_loaded_and_other_files_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("costs.yaml");
        let mut costs = CostModel::new(0.99);
        assert!(!read(&path, &mut costs).unwrap());
        costs.observe(Phase::Iteration, 128, Duration::from_micros(20));
        costs.learn();
        write(&path, &costs).unwrap();
        let mut again = CostModel::new(0.99);
        assert!(read(&path, &mut again).unwrap());
        assert_eq!(again.typical(Phase::Iteration, 128), costs.typical(Phase::Iteration, 128));
        std::fs::write(&path, "[1, 2").unwrap();
        let problem = read(&path, &mut again).unwrap_err().to_string();
        assert!(problem.contains("costs.yaml") && problem.contains("delete it"), "{problem}");
    }
}
