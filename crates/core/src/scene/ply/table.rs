//! The vertices of a `.ply` as a table of numbers with named columns.

use super::Problem;
use ply_rs_bw::{
    parser::{ParseError, Parser, Reader},
    ply::{
        Addable, DefaultElement, ElementDef, Encoding, Header, Property, PropertyAccess,
        PropertyAccessResult, PropertyDef, PropertyType, ScalarType,
    },
    writer::Writer,
};

/// One row per vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Table {
    /// Names of the columns.
    pub(super) names: Vec<String>,
    /// Lines for people and for this program, which other readers pass over.
    pub(super) comments: Vec<String>,
    /// [rows][columns] flat.
    pub(super) values: Vec<f32>,
}

/// A vertex while it is read: its numbers in the order of the header.
struct Row(Vec<f32>);

impl PropertyAccess for Row {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn set_property(&mut self, _: &str, property: Property) -> PropertyAccessResult {
        match property.to_f32_lossy() {
            Some(number) => {
                self.0.push(number);
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::UnsupportedType,
        }
    }
}

impl Table {
    pub(super) fn num_rows(&self) -> usize {
        self.values.len() / self.names.len().max(1)
    }

    pub(super) fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.names.len()..(i + 1) * self.names.len()]
    }

    pub(super) fn has_column(&self, name: &str) -> bool {
        self.position(name).is_some()
    }

    fn position(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }

    /// How many columns `name_0`, `name_1` … there are.
    pub(super) fn count_numbered(&self, name: &str) -> usize {
        (0..).take_while(|i| self.has_column(&format!("{name}_{i}"))).count()
    }

    /// Where the columns of these names are.
    pub(super) fn columns<S: AsRef<str>>(&self, names: &[S]) -> Result<Vec<usize>, Problem> {
        let find = |name: &S| {
            let name = name.as_ref();
            self.position(name).ok_or_else(|| {
                format!("these are not Gaussian splats: the vertices have no property `{name}`")
            })
        };
        names.iter().map(find).collect()
    }

    /// 32-bit floats, little endian.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let mut vertex = ElementDef::new("vertex".to_owned());
        vertex.count = self.num_rows();
        for name in &self.names {
            let kind = PropertyType::Scalar(ScalarType::Float);
            vertex.properties.add(PropertyDef::new(name.clone(), kind));
        }
        let mut header = Header::new();
        header.encoding = Encoding::BinaryLittleEndian;
        header.comments.clone_from(&self.comments);
        header.elements.add(vertex);
        let mut bytes = Vec::new();
        let written = Writer::<DefaultElement>::new().write_header(&mut bytes, &header);
        debug_assert!(written.is_ok(), "writing to memory does not fail: {written:?}");
        bytes.reserve(self.values.len() * size_of::<f32>());
        bytes.extend(self.values.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// Any encoding, any type of number.
    pub(super) fn from_bytes(bytes: &[u8]) -> Result<Self, Problem> {
        let damaged = |e: ParseError| format!("this is not a complete .ply file: {e}");
        let mut reader = Reader::new(bytes);
        let parser = Parser::<Row>::new();
        let header = parser.read_header(&mut reader).map_err(damaged)?;
        let vertex = match header.elements.first() {
            Some((name, vertex)) if name == "vertex" => vertex,
            other => {
                let found = other.map_or("nothing", |(name, _)| name.as_str());
                return Err(format!(
                    "the .ply should begin with vertices, but begins with {found} (compressed files are not read)"
                ));
            }
        };
        let rows = parser.read_payload_for_element(&mut reader, vertex, &header).map_err(damaged)?;
        let names: Vec<String> = vertex.properties.keys().cloned().collect();
        let values = rows.into_iter().flat_map(|row| row.0).collect();
        Ok(Self { names, comments: header.comments, values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_survives_the_round_trip() {
        let table = Table {
            names: vec!["x".into(), "opacity".into()],
            comments: vec!["made by a test".into()],
            values: vec![1.5, -2.0, f32::MAX, 1e-38],
        };
        let bytes = table.to_bytes();
        let head = b"ply\nformat binary_little_endian 1.0\ncomment made by a test\nelement vertex 2\nproperty float x\n";
        assert!(bytes.starts_with(head), "{}", String::from_utf8_lossy(&bytes));
        assert_eq!(Table::from_bytes(&bytes).unwrap(), table);
        for len in 0..bytes.len() {
            assert!(Table::from_bytes(&bytes[..len]).is_err(), "{len} bytes");
        }
    }

    #[test]
    fn other_encodings_and_types_are_read() {
        let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty uchar red\nend_header\n1.5 7\n-2 9\n";
        let table = Table::from_bytes(text.as_bytes()).unwrap();
        assert_eq!((table.num_rows(), table.row(1)), (2, &[-2.0, 9.0][..]));
        let list = "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n2 1 1\n";
        assert!(Table::from_bytes(list.as_bytes()).is_err());
        let chunks = "ply\nformat ascii 1.0\nelement chunk 1\nproperty float min_x\nend_header\n2\n";
        assert!(Table::from_bytes(chunks.as_bytes()).unwrap_err().contains("chunk"));
    }

    #[test]
    fn a_count_beyond_the_file_is_refused() {
        let text = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n";
        assert!(Table::from_bytes(text.as_bytes()).is_err());
    }
}
