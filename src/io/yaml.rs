//! YAML, with its errors in words of YAML.

use serde::de::{DeserializeOwned, IgnoredAny};
use serde_saphyr::Error;

/// Reads a text. The error says what is wrong, with line and column.
pub fn from_str<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_saphyr::from_str(text).map_err(|error| in_words(error.without_snippet(), text))
}

fn in_words(error: &Error, text: &str) -> String {
    let place = error.location().map_or_else(String::new, |place| format!("line {}, column {}: ", place.line(), place.column()));
    match error {
        Error::DuplicateMappingKey { key, .. } => {
            format!("{place}the key '{}' is there for the second time: remove one", key.as_deref().unwrap_or("?"))
        }
        Error::NonFiniteFloat { value, .. } => format!("{place}{value} where a finite number is needed"),
        other => {
            // The library's own words, without the place in them.
            let said = other.to_string();
            let said = said.lines().next().unwrap_or_default();
            let words = said.split(" at line ").next().unwrap_or(said);
            let words = words.rsplit_once(": ").filter(|(before, _)| before.contains("line ")).map_or(words, |(_, words)| words);
            format!("{}{place}{words}", if is_yaml(text) { "" } else { "this is not YAML: " })
        }
    }
}

/// Whether the text is well-formed, whatever it says.
fn is_yaml(text: &str) -> bool {
    serde_saphyr::from_str::<IgnoredAny>(text)
        .err()
        .is_none_or(|error| matches!(error.without_snippet(), Error::DuplicateMappingKey { .. } | Error::NonFiniteFloat { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_in_words_of_yaml_with_their_place() {
        let problem = |text: &str| from_str::<serde_json::Value>(text).unwrap_err();
        assert_eq!(problem("a: 1\nb: 2\na: 3\n"), "line 3, column 1: the key 'a' is there for the second time: remove one");
        assert_eq!(problem("a:\n  b: .nan\n"), "line 2, column 6: .nan where a finite number is needed");
        let not_a_number = from_str::<Vec<f64>>("a: .nan").unwrap_err();
        assert!(!not_a_number.contains("not YAML"), "{not_a_number}");
        assert_eq!(problem("a: ["), "this is not YAML: line 1, column 4: unclosed bracket '['");
    }
}
