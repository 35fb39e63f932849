//! Message types: each is declared once, by name and fields. The text of its definition gives the rest: the full definition for
//! connections and bags, and the MD5 sum by which ROS distinguishes versions of a type.

/// Full definition of a message type.
#[derive(Debug)]
pub struct Definition {
    /// Name and text of the type itself, followed by those of every type that it contains.
    pub types: Vec<(&'static str, &'static str)>,
    /// The texts of all these types, concatenated as in connections and bags.
    pub text: String,
    /// MD5 sum of the definition without comments, with the type of each message field replaced by the MD5 sum of that type.
    pub md5: String,
}

impl Definition {
    /// The definition of the type `name` (`package/Name`) with this text. Contained types that this project does not define are
    /// omitted.
    pub fn new(name: &'static str, text: &'static str) -> Self {
        let mut types = Vec::new();
        add_types(name, text, &mut types);
        let separator = "=".repeat(80);
        let texts =
            types.iter().map(|(other, text)| if *other == name { (*text).into() } else { format!("MSG: {other}\n{text}") });
        let text = texts.collect::<Vec<String>>().join(&format!("\n{separator}\n"));
        Self { md5: md5(name, types[0].1), text, types }
    }
}

/// Adds a type and all types that it contains, each once.
fn add_types(name: &'static str, text: &'static str, types: &mut Vec<(&'static str, &'static str)>) {
    if types.iter().any(|(known, _)| *known == name) {
        return;
    }
    types.push((name, text));
    for (name, text) in lines(text).filter_map(|line| field_type(&line, name)) {
        add_types(name, text, types);
    }
}

/// Computes the MD5 sum as `gendeps --md5` does: constants first, without comments or spaces; message types are replaced by their
/// sums.
fn md5(name: &str, text: &str) -> String {
    let constants = lines(text).filter(Line::is_constant).map(|line| format!("{} {}", line.kind, line.name));
    let fields = lines(text).filter(|line| !line.is_constant()).map(|line| match field_type(&line, name) {
        Some((kind, text)) => format!("{} {}", md5(kind, text), line.name),
        None => format!("{} {}", line.kind, line.name),
    });
    format!("{:x}", md5::compute(constants.chain(fields).collect::<Vec<_>>().join("\n")))
}

/// A field or constant of a definition.
struct Line<'a> {
    kind: &'a str,
    /// Name; that of a constant includes its value: `NAME=1`.
    name: String,
}

impl Line<'_> {
    fn is_constant(&self) -> bool {
        self.name.contains('=')
    }
}

fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
    let halves = lines.filter_map(|line| line.split_once(char::is_whitespace));
    halves.map(|(kind, name)| Line { kind, name: name.split_whitespace().collect() })
}

/// Name and text of the type of a field of the message type `owner`, if it is a message type itself.
fn field_type(line: &Line, owner: &str) -> Option<(&'static str, &'static str)> {
    let kind = line.kind.split('[').next().unwrap_or_default();
    let package = owner.split('/').next().unwrap_or_default();
    let name = match kind {
        "Header" => "std_msgs/Header".into(),
        kind if kind.contains('/') => kind.into(),
        kind => format!("{package}/{kind}"),
    };
    super::TYPES.iter().flat_map(|types| types.iter()).find(|(known, _)| *known == name).copied()
}

/// Declares the message types of one package. Fields must be in the order of the definition, whose text is read from
/// `definitions/`.
macro_rules! messages {
    ($package:literal: $($name:ident { $($field:ident: $kind:ty),* $(,)? })*) => {
        $(
            #[doc = concat!("`", $package, "/", stringify!($name), "`.")]
            #[derive(Clone, Debug, Default, PartialEq, speedy::Readable, speedy::Writable)]
            #[allow(missing_docs)] // the definition explains its fields
            pub struct $name {
                $(pub $field: $kind,)*
            }

            impl super::Message for $name {
                const TYPE: &'static str = concat!($package, "/", stringify!($name));

                fn definition() -> &'static super::Definition {
                    static DEFINITION: std::sync::LazyLock<super::Definition> = std::sync::LazyLock::new(|| {
                        let text = include_str!(concat!("../../definitions/", $package, "/msg/", stringify!($name), ".msg"));
                        super::Definition::new($name::TYPE, text)
                    });
                    &DEFINITION
                }
            }
        )*

        /// Name and definition of each type.
        pub(super) const TYPES: &[(&str, &str)] = &[$((
            concat!($package, "/", stringify!($name)),
            include_str!(concat!("../../definitions/", $package, "/msg/", stringify!($name), ".msg")),
        )),*];

        /// Name of each type and its fields as declared here, for comparison with its definition.
        #[cfg(test)]
        pub(super) const FIELDS: &[super::Fields] = &[$((
            concat!($package, "/", stringify!($name)),
            &[$((stringify!($kind), stringify!($field))),*],
        )),*];
    };
}
pub(super) use messages;

#[cfg(test)]
mod tests {
    use super::super::{FIELDS, TYPES};
    use super::*;

    /// The ROS type of a field.
    fn ros_type(kind: &str) -> String {
        let kind = kind.rsplit("::").next().unwrap();
        if let Some(element) = kind.strip_prefix("Vec<").and_then(|rest| rest.strip_suffix('>')) {
            return format!("{}[]", ros_type(element));
        }
        let scalar = match kind {
            "[f64; 9]" => "float64[9]",
            "Covariance" => "float64[36]",
            "f32" => "float32",
            "f64" => "float64",
            "i8" => "int8",
            "i32" => "int32",
            "u8" => "uint8",
            "u32" => "uint32",
            "String" => "string",
            "Time" => "time",
            "Duration" => "duration",
            other => other,
        };
        scalar.into()
    }

    #[test]
    fn fields_match_the_definition() {
        for ((name, fields), (_, text)) in FIELDS.iter().copied().flatten().zip(TYPES.iter().copied().flatten()) {
            let declared = fields.iter().map(|(kind, field)| format!("{} {}", ros_type(kind), field.trim_end_matches('_')));
            let defined = lines(text).filter(|line| !line.is_constant()).map(|line| {
                let kind = line.kind.rsplit('/').next().unwrap();
                format!("{} {}", if kind == "byte" { "int8" } else { kind }, line.name)
            });
            assert_eq!(declared.collect::<Vec<_>>(), defined.collect::<Vec<_>>(), "{name}");
        }
    }

    #[test]
    fn md5_sums_match_those_of_ros() {
        let sum =
            |name: &str| TYPES.iter().copied().flatten().find(|(known, _)| *known == name).map(|(name, text)| md5(name, text));
        for (name, expected) in [
            ("std_msgs/Empty", "d41d8cd98f00b204e9800998ecf8427e"),
            ("std_msgs/Header", "2176decaecbce78abc3b96ef049fabed"),
            ("sensor_msgs/LaserScan", "90c7ef2dc6895d81024acba2ac42f369"),
            ("sensor_msgs/PointCloud2", "1158d486dd51d683ce2f1be655c3c181"),
            ("nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7"),
            ("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec"),
            ("visualization_msgs/Marker", "4048c9de2a16f4ae8e0538085ebf1b97"),
            ("diagnostic_msgs/DiagnosticArray", "60810da900de1dd6ddd437c3503511da"),
        ] {
            assert_eq!(sum(name).as_deref(), Some(expected), "{name}");
        }
    }

    #[test]
    fn a_full_definition_has_each_type_once() {
        let (name, text) = super::super::nav_msgs::TYPES[0];
        let definition = Definition::new(name, text);
        let types: Vec<&str> = definition.types.iter().map(|(name, _)| *name).collect();
        assert_eq!(types[..3], ["nav_msgs/Odometry", "std_msgs/Header", "geometry_msgs/PoseWithCovariance"]);
        assert_eq!((types.len(), definition.text.matches("\nMSG: ").count()), (9, 8));
    }
}
