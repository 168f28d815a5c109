//! Names of files that are being written.

/// First part of the names of files that are being written.
pub(super) const TEMPORARY: &str = ".part-";

/// Leaves the name of a temporary file out of an error: it means nothing to anybody.
pub(super) fn without_name(fault: std::io::Error) -> std::io::Error {
    match fault.to_string().split_once(" at path ") {
        Some((cause, _)) => std::io::Error::new(fault.kind(), cause),
        None => fault,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::ErrorKind;

    #[test]
    fn nobody_is_told_the_name_of_a_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let fault = || {
            let mut builder = tempfile::Builder::new();
            builder.prefix(TEMPORARY).tempfile_in(folder.path().join("none")).unwrap_err()
        };
        assert!(fault().to_string().contains(TEMPORARY));
        let told = without_name(fault());
        assert!(!told.to_string().is_empty() && !told.to_string().contains(TEMPORARY), "{told}");
        assert_eq!(told.kind(), ErrorKind::NotFound);
        assert_eq!(without_name(std::io::Error::other("it broke")).to_string(), "it broke");
    }
}
