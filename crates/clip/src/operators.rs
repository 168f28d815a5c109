//! Errors about operators and operator sets that a backend does not know, in place of the backend's own
//! message.

use crate::onnx::{ModelProto, NodeProto};

const EXPORT_AGAIN: &str = "Export it again with opset_version=17 and ordinary operators, or set ORT_DYLIB_PATH to a newer ONNX Runtime.";
/// Operator sets that tract supports: those of its tests, and later ones that changed little.
const TRACT_KNOWS: std::ops::RangeInclusive<i64> = 7..=24;

/// Checks the version of a model's operator set, because tract would read any. Returns what is wrong and
/// what to do.
pub(crate) fn wrong_operator_set(model: &ModelProto, is_tract: bool) -> Option<(String, &'static str)> {
    match operator_set(model) {
        None | Some(..1) => {
            Some(("The model does not say which ONNX operator set it uses".to_owned(), EXPORT_AGAIN))
        }
        Some(version) if is_tract && !TRACT_KNOWS.contains(&version) => {
            let (first, last) = (TRACT_KNOWS.start(), TRACT_KNOWS.end());
            let known = format!("the built-in backend knows {first} to {last}");
            Some((format!("The model is of ONNX operator set {version}; {known}"), EXPORT_AGAIN))
        }
        Some(_) => None,
    }
}

/// Explains a backend's refusal of a model, if it is about operators. Returns what is wrong and what to do.
pub(crate) fn explain(model: &ModelProto, message: &str, backend: &str) -> Option<(String, &'static str)> {
    let nodes = || model.graph.iter().flat_map(|graph| &graph.node);
    // The first mark is in messages of tract, the second and third in those of ONNX Runtime.
    let is_named = |node: &&NodeProto| {
        let op = &node.op_type;
        let marks =
            [format!("Unimplemented({op})"), format!("registered for {op} "), format!("{op}(-1) is not")];
        marks.iter().any(|mark| format!("{message} ").contains(mark))
    };
    // tract compares names only and takes an operator of another domain for ONNX's own.
    let is_foreign = |node: &&NodeProto| {
        !node.domain.is_empty() && node.domain != "ai.onnx" && message.contains(&format!("\"{}\"", node.name))
    };
    let version = operator_set(model).unwrap_or_default();
    match nodes().find(is_named).or_else(|| nodes().find(is_foreign)) {
        Some(node) => {
            let domain = if node.domain.is_empty() { "" } else { &format!(" of {}", node.domain) };
            let what = format!(
                "The model uses the operator {}{domain} (operator set {version}), which {backend} does not know",
                node.op_type
            );
            Some((what, EXPORT_AGAIN))
        }
        None if message.contains("Opset") || message.contains("opset") => {
            let what = format!("The model is of ONNX operator set {version}, which {backend} does not know");
            Some((what, EXPORT_AGAIN))
        }
        None => None,
    }
}

/// Version of ONNX's own operator set.
fn operator_set(model: &ModelProto) -> Option<i64> {
    let own = |domain: &str| domain.is_empty() || domain == "ai.onnx";
    model.opset_import.iter().find(|set| own(&set.domain)).map(|set| set.version)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{graph::Graph, onnx::OperatorSetId};
    use prost::Message;

    fn model(op: &str, domain: &str, version: i64) -> ModelProto {
        let graph = Graph::default().node("mean", op, &["image"]);
        let mut model = ModelProto::decode(&graph.into_bytes()[..]).unwrap();
        model.opset_import = vec![OperatorSetId { domain: String::new(), version }];
        model.graph.as_mut().unwrap().node[0].domain = domain.to_owned();
        model
    }

    #[test]
    fn operator_sets_are_checked() {
        let wrong = |version, is_tract| wrong_operator_set(&model("Relu", "", version), is_tract);
        assert_eq!((wrong(17, true), wrong(99, false)), (None, None), "ONNX Runtime knows its own");
        assert!(wrong(99, true).unwrap().0.contains("operator set 99; the built-in backend knows 7 to 24"));
        assert!(wrong(0, false).unwrap().0.contains("does not say"));
    }

    #[test]
    fn refusals_of_the_backends_are_understood() {
        let tract = "Translating node #1 \"mean\" Unimplemented(FancyPool) ToTypedTranslator";
        let runtime = "In Node, (\"mean\", FancyPool, \"\", -1) : Error No Op registered for FancyPool with \
                       domain_version of 13";
        for message in [tract, runtime] {
            let (what, hint) = explain(&model("FancyPool", "", 13), message, "the backend").unwrap();
            assert!(what.contains("operator FancyPool (operator set 13), which the backend"), "{what}");
            assert!(hint.contains("opset_version=17"));
        }
        let foreign = "Failed analyse for node #1 \"mean\" OnnxAttention";
        let explained = |domain: &str| explain(&model("Attention", domain, 13), foreign, "tract");
        assert!(explained("com.microsoft").unwrap().0.contains("operator Attention of com.microsoft"));
        assert_eq!(explained(""), None);
        let set = "ValidateOpsetForDomain(…) ONNX Runtime only *guarantees* support";
        assert!(explain(&model("Relu", "", 99), set, "it").unwrap().0.contains("operator set 99, which it"));
        assert_eq!(explain(&model("Relu", "", 13), "out of memory", "it"), None);
    }
}
