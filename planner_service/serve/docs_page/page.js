// The token is kept by this page alone, until it is closed.
SwaggerUIBundle({
  url: "openapi.json",
  dom_id: "#page",
  deepLinking: true,
  displayRequestDuration: true,
  docExpansion: "list",
  defaultModelsExpandDepth: 0,
  defaultModelExpandDepth: 0,
  defaultModelRendering: "model",
  filter: true,
  tryItOutEnabled: true,
  validatorUrl: "none",
});
