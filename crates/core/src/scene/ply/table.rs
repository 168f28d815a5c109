//! The vertices of a `.ply` as a table of numbers with named columns.

use crate::{reading::NumberType, scene::Problem};

/// One row per vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PlyTable {
    /// Names of the columns.
    pub(super) names: Vec<String>,
    /// Comments for people and for this program, which other readers skip.
    pub(super) comments: Vec<String>,
    /// [rows][columns] flat.
    pub(super) values: Vec<f32>,
}

impl PlyTable {
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

    /// Returns the number of columns `name_0`, `name_1` …
    pub(super) fn count_numbered(&self, name: &str) -> usize {
        (0..).take_while(|i| self.has_column(&format!("{name}_{i}"))).count()
    }

    /// Returns the positions of the columns of these names.
    pub(super) fn columns<S: AsRef<str>>(&self, names: &[S]) -> Result<Vec<usize>, Problem> {
        let find = |name: &S| {
            let name = name.as_ref();
            self.position(name).ok_or_else(|| {
                format!("these are not Gaussian splats: the vertices have no property `{name}`")
            })
        };
        names.iter().map(find).collect()
    }

    /// Returns the file with 32-bit floats, little endian.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let comments = self.comments.iter().map(|comment| format!("comment {comment}\n"));
        let properties = self.names.iter().map(|name| format!("property float {name}\n"));
        let mut bytes = format!(
            "ply\nformat binary_little_endian 1.0\n{}element vertex {}\n{}end_header\n",
            comments.collect::<String>(),
            self.num_rows(),
            properties.collect::<String>()
        )
        .into_bytes();
        bytes.reserve(self.values.len() * size_of::<f32>());
        bytes.extend(self.values.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// Reads any encoding and any type of number. Memory is taken only for as many vertices as
    /// the bytes can hold.
    pub(super) fn from_bytes(bytes: &[u8]) -> Result<Self, Problem> {
        let (header, payload) = PlyHeader::read(bytes)?;
        let (columns, rows) = (header.columns.len(), header.rows);
        let row_bytes = match header.encoding {
            // Each number needs at least a digit and a separator.
            Encoding::Ascii => 2 * columns,
            Encoding::Binary { .. } => header.columns.iter().map(|c| c.number.size).sum(),
        };
        let needed = rows.checked_mul(row_bytes).filter(|_| columns > 0 || rows == 0);
        // The last number of a text needs no separator after it.
        if needed.is_none_or(|n| n > payload.len() + 1) {
            return Err(format!(
                "this is not a complete .ply file: {rows} vertices of {columns} numbers do not fit into {} bytes",
                payload.len()
            ));
        }
        let values: Vec<f32> = match header.encoding {
            Encoding::Ascii => {
                let text = String::from_utf8_lossy(payload);
                let numbers = text.split_ascii_whitespace().take(rows * columns).map(|word| {
                    let damaged = |_| {
                        let beginning: String = word.chars().take(20).collect();
                        format!("this is not a complete .ply file: {beginning:?} is no number")
                    };
                    word.parse().map_err(damaged)
                });
                numbers.collect::<Result<_, _>>()?
            }
            Encoding::Binary { .. } => {
                let mut values = Vec::with_capacity(rows * columns);
                for mut row in payload.chunks_exact(row_bytes.max(1)).take(rows) {
                    for column in &header.columns {
                        let (number, rest) = row.split_at(column.number.size);
                        values.push(column.number.read(number) as f32);
                        row = rest;
                    }
                }
                values
            }
        };
        if values.len() != rows * columns {
            return Err(format!("this is not a complete .ply file: it holds fewer than {rows} vertices"));
        }
        let names = header.columns.into_iter().map(|c| c.name).collect();
        Ok(Self { names, comments: header.comments, values })
    }
}

/// Encoding of the numbers.
#[derive(Clone, Copy)]
enum Encoding {
    Ascii,
    Binary { is_big_endian: bool },
}

/// A property of the vertices.
struct Column {
    name: String,
    number: NumberType,
}

/// Contents of the text before the numbers.
struct PlyHeader {
    encoding: Encoding,
    comments: Vec<String>,
    rows: usize,
    columns: Vec<Column>,
}

impl PlyHeader {
    /// Reads the header and returns it with the bytes after it. Elements after the vertices are skipped.
    fn read(bytes: &[u8]) -> Result<(Self, &[u8]), Problem> {
        let mut lines = Lines(bytes);
        let mut header =
            Self { encoding: Encoding::Ascii, comments: Vec::new(), rows: 0, columns: Vec::new() };
        let (mut has_format, mut elements) = (false, 0);
        if lines.next()? != "ply" {
            return Err("this is not a .ply file".into());
        }
        loop {
            let line = lines.next()?;
            let words: Vec<&str> = line.split_ascii_whitespace().take(4).collect();
            let is_big_endian = matches!(words[..], ["format", "binary_big_endian", ..]);
            match words[..] {
                ["format", "ascii", "1.0"] => has_format = true,
                ["format", "binary_little_endian" | "binary_big_endian", "1.0"] => {
                    header.encoding = Encoding::Binary { is_big_endian };
                    has_format = true;
                }
                ["comment", ..] => {
                    let comment = line.trim_start().strip_prefix("comment").unwrap_or_default();
                    header.comments.push(comment.trim_start().to_owned());
                }
                ["obj_info", ..] => {}
                // The meaning of the columns depends on the encoding.
                ["element" | "property", ..] if !has_format => return Err(bad_line(line)),
                ["element", name, count] => {
                    elements += 1;
                    if elements == 1 {
                        if name != "vertex" {
                            return Err(format!(
                                "the .ply should begin with vertices, but begins with {name:.30} (compressed files are not read)"
                            ));
                        }
                        header.rows = count.parse().map_err(|_| bad_line(line))?;
                    }
                }
                ["property", kind, name] if elements == 1 => {
                    let is_big_endian = matches!(header.encoding, Encoding::Binary { is_big_endian: true });
                    let number = number_type(kind, is_big_endian).ok_or_else(|| bad_line(line))?;
                    header.columns.push(Column { name: name.to_owned(), number });
                }
                ["property", "list", ..] if elements == 1 => {
                    return Err("the vertices of the .ply have lists, expected numbers".into());
                }
                ["property", ..] if elements > 1 => {}
                ["end_header"] => break,
                _ => return Err(bad_line(line)),
            }
        }
        if elements == 0 {
            return Err("the .ply should begin with vertices, but begins with nothing".into());
        }
        let mut names: Vec<&str> = header.columns.iter().map(|c| c.name.as_str()).collect();
        names.sort_unstable();
        if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(format!("the vertices of the .ply have the property `{:.30}` twice", twice[0]));
        }
        Ok((header, lines.0))
    }
}

fn bad_line(line: &str) -> Problem {
    format!("this is not a complete .ply file: its header has the line {line:.60?}")
}

fn number_type(name: &str, is_big_endian: bool) -> Option<NumberType> {
    let name = match name {
        "char" | "int8" => "i1",
        "uchar" | "uint8" => "u1",
        "short" | "int16" => "i2",
        "ushort" | "uint16" => "u2",
        "int" | "int32" => "i4",
        "uint" | "uint32" => "u4",
        "float" | "float32" => "f4",
        "double" | "float64" => "f8",
        _ => return None,
    };
    NumberType::named(name, is_big_endian)
}

/// Bytes that are read line by line.
struct Lines<'a>(&'a [u8]);

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<&'a str, Problem> {
        let end = self
            .0
            .iter()
            .position(|b| *b == b'\n')
            .ok_or("this is not a complete .ply file: its header has no end")?;
        let (line, rest) = self.0.split_at(end);
        self.0 = &rest[1..];
        let line =
            std::str::from_utf8(line).map_err(|_| "this is not a .ply file: its header is not text")?;
        Ok(line.trim_end())
    }
}

/// Returns `name_0`, `name_1` and so on.
pub(super) fn numbered(name: &str, n: usize) -> Vec<String> {
    (0..n).map(|i| format!("{name}_{i}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_survives_the_round_trip() {
        let table = PlyTable {
            names: vec!["x".into(), "opacity".into()],
            comments: vec!["made by a test".into()],
            values: vec![1.5, -2.0, f32::MAX, 1e-38],
        };
        let bytes = table.to_bytes();
        let head = b"ply\nformat binary_little_endian 1.0\ncomment made by a test\nelement vertex 2\nproperty float x\n";
        assert!(bytes.starts_with(head), "{}", String::from_utf8_lossy(&bytes));
        assert_eq!(PlyTable::from_bytes(&bytes).unwrap(), table);
        for len in 0..bytes.len() {
            assert!(PlyTable::from_bytes(&bytes[..len]).is_err(), "{len} bytes");
        }
    }

    #[test]
    fn other_encodings_and_types_are_read() {
        let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty uchar red\nend_header\n1.5 7\n-2 9\n";
        let table = PlyTable::from_bytes(text.as_bytes()).unwrap();
        assert_eq!((table.num_rows(), table.row(1)), (2, &[-2.0, 9.0][..]));
        let list = "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n2 1 1\n";
        assert!(PlyTable::from_bytes(list.as_bytes()).is_err());
        let chunks = "ply\nformat ascii 1.0\nelement chunk 1\nproperty float min_x\nend_header\n2\n";
        assert!(PlyTable::from_bytes(chunks.as_bytes()).unwrap_err().contains("chunk"));
    }

    #[test]
    fn a_count_beyond_the_file_is_refused() {
        let text = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n";
        assert!(PlyTable::from_bytes(text.as_bytes()).is_err());
    }

    #[test]
    fn vertices_without_numbers_and_names_that_come_twice_are_refused() {
        let text = "ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n";
        assert!(PlyTable::from_bytes(text.as_bytes()).unwrap_err().contains("do not fit"));
        let text = "ply\nformat ascii 1.0\nelement vertex 3000\nproperty float x\nend_header\n1 2 3\n";
        assert!(PlyTable::from_bytes(text.as_bytes()).is_err());
        let twice =
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float x\nend_header\n1 2\n";
        assert!(PlyTable::from_bytes(twice.as_bytes()).unwrap_err().contains("twice"));
    }

    #[test]
    fn both_byte_orders_and_what_follows_the_vertices_are_understood() {
        let head = |order: &str| {
            format!(
                "ply\r\nformat binary_{order}_endian 1.0\r\nobj_info a\r\nelement vertex 2\r\nproperty float32 x\r\n\
                 property uint16 n\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
            )
        };
        let rows = [(1.5_f32, 7_u16), (-2.0, 500)];
        let little = rows.iter().flat_map(|(x, n)| [&x.to_le_bytes()[..], &n.to_le_bytes()].concat());
        let big = rows.iter().flat_map(|(x, n)| [&x.to_be_bytes()[..], &n.to_be_bytes()].concat());
        for (order, data) in [("little", little.collect::<Vec<u8>>()), ("big", big.collect())] {
            let bytes = [head(order).as_bytes(), &data, &[1, 0, 0, 0, 0]].concat();
            let table = PlyTable::from_bytes(&bytes).unwrap();
            assert_eq!(table.values, [1.5, 7.0, -2.0, 500.0], "{order}");
        }
    }
}
