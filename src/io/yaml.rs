//! YAML parsing with readable error messages.

use serde::de::{DeserializeOwned, IgnoredAny};
use serde_saphyr::Error;

/// Deserializes a YAML text. The error says what is wrong, with line and column.
pub fn from_str<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_saphyr::from_str(text).map_err(|error| describe(error.without_snippet(), text))
}

fn describe(error: &Error, text: &str) -> String {
    let position = error.location().map_or_else(String::new, |at| format!("line {}, column {}: ", at.line(), at.column()));
    match error {
        Error::DuplicateMappingKey { key, .. } => {
            format!("{position}duplicate key '{}': remove one of them", key.as_deref().unwrap_or("?"))
        }
        Error::NonFiniteFloat { value, .. } => format!("{position}found {value}, expected a finite number"),
        other => {
            // The message of the library, without the position in it.
            let message = other.to_string();
            let message = message.lines().next().unwrap_or_default();
            let text_only = message.split(" at line ").next().unwrap_or(message);
            let text_only =
                text_only.rsplit_once(": ").filter(|(before, _)| before.contains("line ")).map_or(text_only, |(_, rest)| rest);
            format!("{}{position}{text_only}", if is_yaml(text) { "" } else { "this is not YAML: " })
        }
    }
}

/// Whether the text is well-formed YAML, whatever its content.
fn is_yaml(text: &str) -> bool {
    serde_saphyr::from_str::<IgnoredAny>(text)
        .err()
        .is_none_or(|error| matches!(error.without_snippet(), Error::DuplicateMappingKey { .. } | Error::NonFiniteFloat { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_readable_and_give_line_and_column() {
        let problem = |text: &str| from_str::<serde_json::Value>(text).unwrap_err();
        assert_eq!(problem("a: 1\nb: 2\na: 3\n"), "line 3, column 1: duplicate key 'a': remove one of them");
        assert_eq!(problem("a:\n  b: .nan\n"), "line 2, column 6: found .nan, expected a finite number");
        let not_a_number = from_str::<Vec<f64>>("a: .nan").unwrap_err();
        assert!(!not_a_number.contains("not YAML"), "{not_a_number}");
        assert_eq!(problem("a: ["), "this is not YAML: line 1, column 4: unclosed bracket '['");
    }
}
