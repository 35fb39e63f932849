//! Knobs: the parameters of the program, each declared once.
//!
//! A module declares its parameters with [`knobs!`](crate::knobs!): name, type, default, range, unit and help on two lines. From
//! this single declaration follow the struct that the code reads, the YAML file, the ROS parameters, `--set` and
//! docs/parameters.md. [`crate::config`] combines the groups.

use std::f64::consts::TAU;
use std::fmt::Display;

/// An unchecked parameter value, as read from YAML, the ROS parameter server or `--set`.
pub type Value = serde_json::Value;

/// Description of a parameter.
#[derive(Clone, Debug)]
pub struct KnobInfo {
    /// Name within its group.
    pub name: &'static str,
    /// Help text.
    pub help: &'static str,
    /// Unit of the value; empty if it has none.
    pub unit: &'static str,
    /// Description of the accepted values.
    pub accepts: String,
    /// Default value.
    pub default: Value,
}

/// A group of parameters: a struct declared with [`knobs!`](crate::knobs!).
pub trait KnobGroup {
    /// All parameters of the group with their defaults, in the order of declaration.
    fn table(&self) -> Vec<KnobInfo>;
    /// The current value of a parameter.
    fn get(&self, name: &str) -> Option<Value>;
    /// Sets a parameter. `None`: there is no parameter of that name. `Some(Err)`: the value is invalid, and the parameter keeps
    /// its old value.
    fn set(&mut self, name: &str, value: &Value) -> Option<Result<(), String>>;
}

/// A type of parameter values.
pub trait KnobValue: Sized {
    /// Parses a value; the error states what was expected.
    fn from_value(value: &Value) -> Result<Self, String>;
    /// The value as it is written to files.
    fn to_value(&self) -> Value;
    /// Description of the type: `number`, `one of a | b`.
    fn kind() -> String;
    /// The value as a number for the range check; `None` for types without an order.
    fn number(&self) -> Option<f64> {
        None
    }
}

/// The error message for a value of the wrong type.
pub(crate) fn expected(kind: impl Display, value: &Value) -> String {
    format!("expected {kind}, got {value}")
}

/// The numbers of a list; `None` unless it is a list of finite numbers.
pub(crate) fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(|number| number.as_f64().filter(|number| number.is_finite())).collect()
}

impl KnobValue for bool {
    fn from_value(value: &Value) -> Result<Self, String> {
        value.as_bool().ok_or_else(|| expected(Self::kind(), value))
    }
    fn to_value(&self) -> Value {
        (*self).into()
    }
    fn kind() -> String {
        "true | false".into()
    }
}

impl KnobValue for u32 {
    fn from_value(value: &Value) -> Result<Self, String> {
        value.as_u64().and_then(|v| Self::try_from(v).ok()).ok_or_else(|| expected(Self::kind(), value))
    }
    fn to_value(&self) -> Value {
        (*self).into()
    }
    fn kind() -> String {
        "whole number".into()
    }
    fn number(&self) -> Option<f64> {
        Some(f64::from(*self))
    }
}

/// Whole numbers are accepted, too: the ROS parameter server stores `1` as an integer.
impl KnobValue for f64 {
    fn from_value(value: &Value) -> Result<Self, String> {
        value.as_f64().filter(|v| v.is_finite()).ok_or_else(|| expected(Self::kind(), value))
    }
    fn to_value(&self) -> Value {
        (*self).into()
    }
    fn kind() -> String {
        "number".into()
    }
    fn number(&self) -> Option<f64> {
        Some(*self)
    }
}

impl KnobValue for String {
    fn from_value(value: &Value) -> Result<Self, String> {
        value.as_str().map(Into::into).ok_or_else(|| expected(Self::kind(), value))
    }
    fn to_value(&self) -> Value {
        self.as_str().into()
    }
    fn kind() -> String {
        "text".into()
    }
}

/// A duration in seconds, read from a number of seconds or from text with a unit (`5ms`, `200us`). Text without a unit is in
/// seconds, too.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Seconds(pub f64);

impl KnobValue for Seconds {
    fn from_value(value: &Value) -> Result<Self, String> {
        match value {
            Value::String(text) => seconds(text).map(Self).map_err(|e| format!("expected {}, got {value} ({e})", Self::kind())),
            _ => f64::from_value(value).map(Self).map_err(|_| expected(Self::kind(), value)),
        }
    }
    fn to_value(&self) -> Value {
        self.0.into()
    }
    fn kind() -> String {
        "seconds, or text such as 5ms".into()
    }
    fn number(&self) -> Option<f64> {
        Some(self.0)
    }
}

/// Parses seconds from text. A negative sign is accepted here, so that the range check can report the negative value.
fn seconds(text: &str) -> Result<f64, humantime::DurationError> {
    let (sign, span) = text.trim().strip_prefix('-').map_or((1.0, text.trim()), |span| (-1.0, span));
    let number = span.parse().ok().filter(|number: &f64| number.is_finite());
    let seconds = number.map_or_else(|| humantime::parse_duration(span).map(|span| span.as_secs_f64()), Ok)?;
    Ok(sign * seconds)
}

/// An optional value; `null` and the text `unset` mean that it is not set.
impl<T: KnobValue> KnobValue for Option<T> {
    fn from_value(value: &Value) -> Result<Self, String> {
        match value {
            Value::Null => Ok(None),
            Value::String(text) if text.is_empty() || text == "unset" => Ok(None),
            _ => T::from_value(value).map(Some),
        }
    }
    fn to_value(&self) -> Value {
        self.as_ref().map_or(Value::Null, KnobValue::to_value)
    }
    fn kind() -> String {
        format!("{} | unset", T::kind())
    }
    fn number(&self) -> Option<f64> {
        self.as_ref().and_then(KnobValue::number)
    }
}

/// A pose as `[x, y, yaw]`, m and rad.
impl KnobValue for crate::geometry::Pose2 {
    fn from_value(value: &Value) -> Result<Self, String> {
        match numbers(value).as_deref() {
            Some(&[x, y, yaw]) => Ok(Self::new(x, y, radians(yaw)?)),
            _ => Err(expected(Self::kind(), value)),
        }
    }
    fn to_value(&self) -> Value {
        vec![self.x, self.y, self.theta].into()
    }
    fn kind() -> String {
        "[x, y, yaw]".into()
    }
}

/// Checks an angle entered by a user, rad: more than a full turn was probably meant in degrees.
pub(crate) fn radians(angle: f64) -> Result<f64, String> {
    if angle.abs() > TAU {
        return Err(format!("an angle of {angle} is more than a full turn: radians are expected, 90 degrees are 1.5708"));
    }
    Ok(angle)
}

/// The candidate most similar to a mistyped `name`, if one is similar enough.
pub fn nearest_name<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let (similarity, nearest) = by_similarity(name, candidates).into_iter().next()?;
    (similarity > 0.7).then_some(nearest)
}

/// The `count` candidates most similar to a mistyped `name`, the most similar first.
pub fn nearest_names<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>, count: usize) -> Vec<&'a str> {
    by_similarity(name, candidates).into_iter().take(count).map(|(_, candidate)| candidate).collect()
}

/// Candidates with their similarity, the most similar first. The last component of a path is also compared alone, because the
/// group is easily forgotten.
fn by_similarity<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Vec<(f64, &'a str)> {
    fn last_component(path: &str) -> &str {
        path.rsplit('.').next().unwrap_or(path)
    }
    let similarity = |candidate: &str| {
        let by_last_component = 0.98 * strsim::jaro_winkler(last_component(name), last_component(candidate));
        strsim::jaro_winkler(name, candidate).max(by_last_component)
    };
    let mut similar: Vec<_> = candidates.into_iter().map(|candidate| (similarity(candidate), candidate)).collect();
    similar.sort_by(|a, b| b.0.total_cmp(&a.0));
    similar
}

/// Declares an enum whose values a parameter can take by name.
///
/// ```
/// anytime_scan_matcher::choices! {
///     /// Side of the road.
///     pub enum Side {
///         /// Keep left.
///         Left = "left",
///         /// Keep right.
///         Right = "right",
///     }
/// }
/// assert_eq!(Side::Right.name(), "right");
/// ```
#[macro_export]
macro_rules! choices {
    ($(#[$attribute:meta])* pub enum $name:ident { $($(#[doc = $help:literal])* $(#[cfg($condition:meta)])? $variant:ident = $text:literal),+ $(,)? }) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name { $($(#[doc = $help])* $(#[cfg($condition)])? $variant),+ }

        impl $name {
            /// All values, in the order of declaration.
            pub const ALL: &'static [Self] = &[$($(#[cfg($condition)])? Self::$variant),+];

            /// The name of the value in files and parameters.
            pub fn name(self) -> &'static str {
                match self { $($(#[cfg($condition)])? Self::$variant => $text),+ }
            }
        }

        impl $crate::knobs::KnobValue for $name {
            fn from_value(value: &$crate::knobs::Value) -> Result<Self, String> {
                Self::ALL
                    .iter()
                    .copied()
                    .find(|choice| value.as_str() == Some(choice.name()))
                    .ok_or_else(|| format!("expected {}, got {value}", <Self as $crate::knobs::KnobValue>::kind()))
            }
            fn to_value(&self) -> $crate::knobs::Value {
                self.name().into()
            }
            fn kind() -> String {
                [$($(#[cfg($condition)])? $text),+].join(" | ")
            }
        }
    };
}

/// Declares a group of parameters.
///
/// ```
/// use anytime_scan_matcher::knobs::KnobGroup;
///
/// anytime_scan_matcher::knobs! {
///     /// Wheels.
///     pub struct WheelKnobs {
///         /// Radius of a wheel.
///         radius: f64 = 0.05, in 0.01 to 1, unit "m";
///         /// Whether it has a brake.
///         brake: bool = false;
///     }
/// }
/// let mut knobs = WheelKnobs::default();
/// assert_eq!(knobs.set("radius", &0.2.into()), Some(Ok(())));
/// assert!(knobs.set("radius", &5.into()).unwrap().is_err());
/// assert_eq!(knobs.set("raduis", &0.2.into()), None);
/// ```
#[macro_export]
macro_rules! knobs {
    ($(#[$attribute:meta])* pub struct $group:ident {
        $($(#[doc = $help:literal])+ $name:ident : $kind:ty = $default:expr $(, in $low:literal to $high:literal)? $(, unit $unit:literal)? ;)+
    }) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $group { $($(#[doc = $help])+ pub $name: $kind,)+ }

        impl Default for $group {
            fn default() -> Self {
                Self { $($name: $default,)+ }
            }
        }

        impl $crate::knobs::KnobGroup for $group {
            fn table(&self) -> Vec<$crate::knobs::KnobInfo> {
                let default = Self::default();
                vec![$($crate::knobs::KnobInfo {
                    name: stringify!($name),
                    help: concat!($($help),+).trim(),
                    unit: concat!("" $(, $unit)?),
                    accepts: <$kind as $crate::knobs::KnobValue>::kind() + concat!("" $(, ", ", $low, " to ", $high)?),
                    default: $crate::knobs::KnobValue::to_value(&default.$name),
                }),+]
            }

            fn get(&self, name: &str) -> Option<$crate::knobs::Value> {
                match name {
                    $(stringify!($name) => Some($crate::knobs::KnobValue::to_value(&self.$name)),)+
                    _ => None,
                }
            }

            fn set(&mut self, name: &str, value: &$crate::knobs::Value) -> Option<Result<(), String>> {
                match name {
                    $(stringify!($name) => Some(<$kind as $crate::knobs::KnobValue>::from_value(value).and_then(|parsed| {
                        $($crate::knobs::check_range($crate::knobs::KnobValue::number(&parsed), f64::from($low), f64::from($high))?;)?
                        self.$name = parsed;
                        Ok(())
                    })),)+
                    _ => None,
                }
            }
        }
    };
}

/// The range check of [`knobs!`](crate::knobs!).
#[doc(hidden)]
pub fn check_range(number: Option<f64>, low: f64, high: f64) -> Result<(), String> {
    match number {
        Some(number) if number < 0.0 && low >= 0.0 => Err(format!("expected {low} to {high}, got {number}, which is negative")),
        Some(number) if !(low..=high).contains(&number) => Err(format!("expected {low} to {high}, got {number}")),
        _ => Ok(()),
    }
}
